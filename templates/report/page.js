// What is around the map: switches, search, the part under the pointer, the sensor window, links from the tables.
const WINDOW_MM = [20, 15];
const WEAK = 16;
const SYMBOL_WORDS = {
  N: "up", W: "left", E: "right", S: "down", n: "up and right", w: "up and left", e: "down and right", s: "down and left",
};
/** Bits of a symbol: x and y, or the three of eight directions. */
const bitsOf = (symbol) => (data.codes ? data.codes[symbol].toString(2).padStart(3, "0") : `${symbol & 1}, ${symbol >> 1}`);

const number = new Map(places.names.map((name, i) => [name.toLowerCase(), i]));
let hovered = -1, selected = -1, spot = null;
const sensor = { x: ((columns - 1) / 2) * pitch, y: ((rows - 1) / 2) * pitch, turn: 0, shown: true, seen: [], square: null };

function listInto(id, items) {
  element(id).replaceChildren(...items.map(([name, value]) => {
    const row = document.createElement("div"), description = document.createElement("dd");
    if (name) {
      const term = document.createElement("dt");
      term.textContent = name;
      row.append(term);
    }
    if (value instanceof Node) description.append(value);
    else description.textContent = value;
    row.append(description);
    return row;
  }));
}

// The part

function describe(i) {
  const x = places.xy[2 * i], y = places.xy[2 * i + 1], [tx, ty] = toTexture(x, y);
  const c = places.cells[2 * i], r = places.cells[2 * i + 1], letter = data.letters[places.symbols[i]];
  const lines = [
    ["designator", places.names[i]],
    ["column, row", `${c}, ${r}`],
    ["code index", `${data.origin[0] + c}, ${data.origin[1] + r}`],
    ["symbol", `${letter}, ${SYMBOL_WORDS[letter]}; bits ${bitsOf(places.symbols[i])}`],
    ["texture x, y", `${mm(tx, 4)}, ${mm(ty, 4)} mm`],
  ];
  if (places.model) lines.push(["on the part", `${[0, 1, 2].map((axis) => mm(places.model[3 * i + axis])).join(", ")} mm`]);
  else lines.push(["board x, y", `${mm(x, 4)}, ${mm(y, 4)} mm`], ["rotation", `${places.turns[i]}°`]);
  return lines;
}

function showPart() {
  const i = hovered >= 0 ? hovered : selected;
  listInto("part", i >= 0 ? describe(i) : [["", "Point at a part, or click it to keep it."]]);
}

function select(i, { look = false, say = false } = {}) {
  selected = i;
  hovered = -1;
  showPart();
  if (i < 0) return refresh();
  const x = places.xy[2 * i], y = places.xy[2 * i + 1];
  const inside = Math.abs(screenX(x) - width / 2) < width * 0.45 && Math.abs(screenY(y) - height / 2) < height * 0.45;
  if (look || !inside) lookAt(x, y, look ? Math.max(view.k, Math.min(width, height) / (14 * pitch)) : view.k);
  if (say) element("found").textContent = `${places.names[i]}: column ${places.cells[2 * i]}, row ${places.cells[2 * i + 1]}, ${data.letters[places.symbols[i]]}`;
  refresh();
}

function nearestPart(u, v) {
  const x = boardX(u), y = boardY(v), reach = Math.max(0.55 * pitch, 4 / view.k);
  let best = -1, least = reach * reach;
  for (let i = 0; i < count; i++) {
    const dx = places.xy[2 * i] - x, dy = places.xy[2 * i + 1] - y, square = dx * dx + dy * dy;
    if (square < least) {
      least = square;
      best = i;
    }
  }
  return best;
}

function ring(brush, x, y, radius, colour, widthPx) {
  for (const [ink, extra] of [["#ffffff", 2.5], [colour, 0]]) {
    brush.strokeStyle = ink;
    brush.lineWidth = widthPx + extra;
    brush.beginPath();
    brush.arc(screenX(x), screenY(y), radius, 0, 2 * Math.PI);
    brush.stroke();
  }
}

overlays.push((brush) => {
  const radius = Math.max(7, 0.62 * Math.max(data.body_mm[0], data.body_mm[1]) * view.k);
  if (selected >= 0) ring(brush, places.xy[2 * selected], places.xy[2 * selected + 1], radius, "#0072b2", 3);
  if (hovered >= 0 && hovered !== selected) ring(brush, places.xy[2 * hovered], places.xy[2 * hovered + 1], radius, "#1b1f24", 1.5);
  if (spot) ring(brush, spot.x, spot.y, 12, "#d55e00", 3);
});

// Search

function find(text) {
  const wish = text.trim().toLowerCase();
  const point = wish.match(/^(\d{1,7})\s*[,;\s]\s*(\d{1,7})$/);
  const i = point ? onPoint(Number(point[1]), Number(point[2])) : (number.get(wish) ?? number.get(`r${wish}`) ?? -1);
  if (i >= 0) {
    spot = null;
    select(i, { look: true, say: true });
  } else {
    element("found").textContent = point
      ? `no part on column ${point[1]}, row ${point[2]}; the grid has columns 0 to ${columns - 1} and rows 0 to ${rows - 1}`
      : `no part ${text.trim().slice(0, 40)}; they are ${places.names[0]} to ${places.names[count - 1]}`;
  }
}

element("find").addEventListener("submit", (event) => {
  event.preventDefault();
  if (element("wanted").value.trim()) find(element("wanted").value);
});

// Layers

for (const layer of [...data.layers, { id: "grid", title: "Grid", shown: false }, { id: "symbols", title: "Symbols", shown: false }]) {
  const label = document.createElement("label"), box = document.createElement("input");
  box.type = "checkbox";
  box.checked = layer.shown;
  box.id = `layer-${layer.id}`;
  box.addEventListener("change", () => {
    if (box.checked) shown.add(layer.id);
    else shown.delete(layer.id);
    changed();
  });
  label.append(box, layer.title);
  element("layers").append(label);
}

// The sensor window

/** The largest square of grid points whose parts are all seen: its upper left cell and its side. */
function largestSquare(seen) {
  const inside = new Set(seen.map((i) => places.cells[2 * i + 1] * columns + places.cells[2 * i]));
  const side = new Map();
  let best = { side: 0, column: 0, row: 0 };
  for (const cell of [...inside].sort((a, b) => a - b)) {
    const c = cell % columns, r = (cell - c) / columns;
    const s = c && r ? 1 + Math.min(side.get(cell - 1) ?? 0, side.get(cell - columns) ?? 0, side.get(cell - columns - 1) ?? 0) : 1;
    side.set(cell, s);
    if (s > best.side) best = { side: s, column: c - s + 1, row: r - s + 1 };
  }
  return best;
}

function judge(side) {
  const needed = data.contact.told_apart, safe = data.contact.one_wrong_symbol;
  if (needed === null) return ["bad", "✗ not by the certificate: no square of up to 8 x 8 parts names its place everywhere"];
  if (side < needed) return ["bad", `✗ not by the certificate: it asks for ${needed} x ${needed} parts in a square`];
  if (safe !== null && side >= safe) return ["good", `✓ can be located, even with one symbol read wrongly (${safe} x ${safe} are enough)`];
  return ["note", `! can be located where every symbol is read rightly (${needed} x ${needed} are enough for that)`];
}

function senseAgain() {
  const angle = (sensor.turn * Math.PI) / 180, cos = Math.cos(angle), sin = Math.sin(angle);
  sensor.seen = [];
  for (let i = 0; i < count; i++) {
    const dx = places.xy[2 * i] - originX - sensor.x, dy = originY - places.xy[2 * i + 1] - sensor.y;
    if (Math.abs(dx * cos - dy * sin) <= WINDOW_MM[0] / 2 && Math.abs(dx * sin + dy * cos) <= WINDOW_MM[1] / 2) sensor.seen.push(i);
  }
  sensor.square = largestSquare(sensor.seen);
  const dots = sensor.seen.length, [tone, words] = judge(sensor.square.side), verdict = document.createElement("span");
  verdict.className = `mark-line ${tone}`;
  verdict.textContent = words;
  listInto("window", [
    ["dots", `${dots}, ${dots === 0 ? "none" : dots < WEAK ? "weak" : "solid"}`],
    ["bits", `${(data.codes ? 3 : 2) * dots}`],
    ["whole square", sensor.square.side ? `${sensor.square.side} x ${sensor.square.side} parts from column ${sensor.square.column}, row ${sensor.square.row}` : "none"],
    ["", verdict],
  ]);
  for (const [id, value] of [["window-x", sensor.x], ["window-y", sensor.y], ["window-turn", sensor.turn]]) {
    if (document.activeElement !== element(id)) element(id).value = String(Math.round(value * 1000) / 1000);
  }
  refresh();
}

/** Corners of the window in pixels. */
function windowCorners() {
  const angle = (sensor.turn * Math.PI) / 180, cos = Math.cos(angle) * view.k, sin = Math.sin(angle) * view.k;
  const [x, y] = toBoard(sensor.x, sensor.y), u = screenX(x), v = screenY(y);
  return [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => {
    const p = (a * WINDOW_MM[0]) / 2, q = (b * WINDOW_MM[1]) / 2;
    return [u + p * cos + q * sin, v - p * sin + q * cos];
  });
}

/** Whether a pixel takes hold of the window: all of it, or only its border where it fills the view. */
function onWindow(u, v) {
  if (!sensor.shown) return false;
  const angle = (sensor.turn * Math.PI) / 180, cos = Math.cos(angle), sin = Math.sin(angle);
  const [x, y] = toBoard(sensor.x, sensor.y), du = u - screenX(x), dv = v - screenY(y);
  const across = Math.abs(du * cos - dv * sin) - (WINDOW_MM[0] / 2) * view.k, down = Math.abs(du * sin + dv * cos) - (WINDOW_MM[1] / 2) * view.k;
  const out = Math.max(across, down);
  const whole = windowCorners().every(([p, q]) => p > 0 && q > 0 && p < width && q < height);
  return out < 8 && (whole || out > -12);
}

overlays.push((brush) => {
  if (!sensor.shown) return;
  const corners = windowCorners();
  const trace = (points) => {
    brush.beginPath();
    points.forEach(([u, v], i) => (i ? brush.lineTo(u, v) : brush.moveTo(u, v)));
    brush.closePath();
  };
  const { side, column, row } = sensor.square;
  if (side) {
    const [left, top] = toBoard((column - 0.5) * pitch, (row - 0.5) * pitch), [right, bottom] = toBoard((column + side - 0.5) * pitch, (row + side - 0.5) * pitch);
    trace([[left, top], [right, top], [right, bottom], [left, bottom]].map(([x, y]) => [screenX(x), screenY(y)]));
    brush.fillStyle = "rgba(86, 180, 233, 0.28)";
    brush.fill();
  }
  const radius = Math.max(1.6, 0.2 * pitch * view.k);
  brush.beginPath();
  for (const i of sensor.seen) {
    const u = screenX(places.xy[2 * i]), v = screenY(places.xy[2 * i + 1]);
    if (u < -radius || v < -radius || u > width + radius || v > height + radius) continue;
    brush.moveTo(u + radius, v);
    brush.arc(u, v, radius, 0, 2 * Math.PI);
  }
  brush.strokeStyle = "#56b4e9";
  brush.lineWidth = Math.min(3, Math.max(1, radius / 3));
  brush.stroke();
  trace(corners);
  for (const [ink, widthPx] of [["#ffffff", 5], ["#0072b2", 2.5]]) {
    brush.strokeStyle = ink;
    brush.lineWidth = widthPx;
    brush.stroke();
  }
  brush.beginPath();
  const tick = [0, 1].map((axis) => (corners[0][axis] + corners[1][axis]) / 2), centre = [0, 1].map((axis) => (corners[0][axis] + corners[2][axis]) / 2);
  brush.moveTo(tick[0], tick[1]);
  brush.lineTo(tick[0] + (centre[0] - tick[0]) * 0.12, tick[1] + (centre[1] - tick[1]) * 0.12);
  brush.stroke();
});

function placeWindow(x, y) {
  const [left, top] = toTexture(0, data.size_mm[1]), [right, bottom] = toTexture(data.size_mm[0], 0);
  const reach = Math.max(...WINDOW_MM) / 2;
  sensor.x = Math.min(right + reach, Math.max(left - reach, x));
  sensor.y = Math.min(bottom + reach, Math.max(top - reach, y));
  senseAgain();
}

for (const [id, place] of [
  ["window-x", (value) => placeWindow(value, sensor.y)],
  ["window-y", (value) => placeWindow(sensor.x, value)],
  ["window-turn", (value) => { sensor.turn = Math.min(180, Math.max(-180, value)); senseAgain(); }],
]) {
  element(id).addEventListener("input", (event) => {
    if (Number.isFinite(event.target.valueAsNumber)) place(event.target.valueAsNumber);
  });
  element(id).addEventListener("blur", senseAgain);
}
element("window-shown").addEventListener("change", (event) => {
  sensor.shown = event.target.checked;
  refresh();
});

// Pointers on the map

const held = new Map();
let grip = null, travelled = 0, spread = 0;

const spot2 = (event) => {
  const box = canvas.getBoundingClientRect();
  return [event.clientX - box.left - 1, event.clientY - box.top - 1];
};

canvas.addEventListener("pointerdown", (event) => {
  if (event.button !== 0) return;
  const [u, v] = spot2(event);
  canvas.setPointerCapture(event.pointerId);
  held.set(event.pointerId, [u, v]);
  travelled = 0;
  spot = null;
  const [x, y] = toTexture(boardX(u), boardY(v));
  grip = held.size === 1 && onWindow(u, v) ? [sensor.x - x, sensor.y - y] : null;
  canvas.classList.add("busy");
});

canvas.addEventListener("pointermove", (event) => {
  const [u, v] = spot2(event), before = held.get(event.pointerId);
  const [x, y] = toTexture(boardX(u), boardY(v));
  element("pointer").textContent = `texture ${mm(x)}, ${mm(y)} mm${places.model ? "" : `; board ${mm(boardX(u))}, ${mm(boardY(v))} mm`}`;
  if (!before) {
    canvas.classList.toggle("on-window", onWindow(u, v));
    const now = nearestPart(u, v);
    if (now !== hovered) {
      hovered = now;
      showPart();
      refresh();
    }
    return;
  }
  held.set(event.pointerId, [u, v]);
  travelled += Math.hypot(u - before[0], v - before[1]);
  if (held.size === 2) {
    const [a, b] = [...held.values()], apart = Math.hypot(a[0] - b[0], a[1] - b[1]);
    if (spread > 0 && apart > 0) zoomAt((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, apart / spread);
    spread = apart;
    panBy((u - before[0]) / 2, (v - before[1]) / 2);
  } else if (travelled > 3) {
    if (grip) placeWindow(x + grip[0], y + grip[1]);
    else panBy(u - before[0], v - before[1]);
  }
});

function letGo(event) {
  if (!held.delete(event.pointerId)) return;
  spread = 0;
  if (held.size) return;
  canvas.classList.remove("busy");
  if (event.type === "pointerup" && travelled <= 3) select(nearestPart(...spot2(event)), { say: true });
  grip = null;
}
canvas.addEventListener("pointerup", letGo);
canvas.addEventListener("pointercancel", letGo);
canvas.addEventListener("pointerleave", () => {
  if (held.size) return;
  hovered = -1;
  showPart();
  element("pointer").textContent = "point at the tape";
  refresh();
});
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  const step = event.deltaY * (event.deltaMode === 1 ? 30 : 1);
  zoomAt(...spot2(event), Math.exp(-Math.max(-200, Math.min(200, step)) * 0.0022));
}, { passive: false });

// Keys

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

canvas.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const arrow = ARROWS[event.key];
  if (arrow && selected >= 0 && !event.shiftKey) {
    let c = places.cells[2 * selected], r = places.cells[2 * selected + 1], next = -1;
    while (next < 0 && c >= 0 && r >= 0 && c < columns && r < rows) {
      c += arrow[0];
      r += arrow[1];
      next = onPoint(c, r);
    }
    if (next >= 0) select(next, { say: true });
  } else if (arrow) panBy(-60 * arrow[0], -60 * arrow[1]);
  else if (event.key === "+" || event.key === "=") zoomAt(width / 2, height / 2, 1.3);
  else if (event.key === "-" || event.key === "_") zoomAt(width / 2, height / 2, 1 / 1.3);
  else if (event.key === "0") showAll();
  else if (event.key === "Escape") {
    spot = null;
    select(-1);
  } else if (event.key === "Enter" || event.key === " ") select(nearestPart(width / 2, height / 2), { say: true });
  else return;
  event.preventDefault();
});
document.addEventListener("keydown", (event) => {
  if (event.key !== "/" || event.ctrlKey || event.metaKey || event.target.closest("input, textarea")) return;
  event.preventDefault();
  element("wanted").focus();
});
element("zoom-in").addEventListener("click", () => zoomAt(width / 2, height / 2, 1.3));
element("zoom-out").addEventListener("click", () => zoomAt(width / 2, height / 2, 1 / 1.3));
element("zoom-all").addEventListener("click", showAll);

// Links from the tables

document.addEventListener("click", (event) => {
  const link = event.target.closest("button.link");
  if (!link) return;
  if (link.dataset.part) find(link.dataset.part);
  else {
    select(-1);
    spot = { x: Number(link.dataset.x), y: Number(link.dataset.y) };
    lookAt(spot.x, spot.y, Math.max(view.k, Math.min(width, height) / (14 * pitch)));
  }
  element("map").scrollIntoView({ block: "start" });
  canvas.focus({ preventScroll: true });
});

// Beginning, and paper

let solid = null;
if (data.solid && element("shaded")) {
  solid = solidView(data.solid, element("shaded"));
  const { shown: some, total } = data.solid, grouped = (value) => value.toString().replace(/\B(?=(\d{3})+$)/g, ",");
  element("shaded-what").textContent = some < total
    ? `A piece of the written STL: ${grouped(some)} of its ${grouped(total)} triangles.`
    : `The written STL, ${grouped(total)} triangles.`;
}

let closed = [];
window.addEventListener("beforeprint", () => {
  closed = [...document.querySelectorAll("details:not([open])")];
  for (const details of closed) details.open = true;
  if (solid) solid.draw();
});
window.addEventListener("afterprint", () => {
  for (const details of closed) details.open = false;
});

resize();
placeWindow(sensor.x, sensor.y);
showPart();
work(400);
show();
new ResizeObserver(resize).observe(canvas);
