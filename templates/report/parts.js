// What is around the map: switches, search, the part under the pointer, links from the tables.
const SYMBOL_WORDS = {
  N: "up", W: "left", E: "right", S: "down", n: "up and right", w: "up and left", e: "down and right", s: "down and left",
};
/** Bits of a symbol: x and y, or the three of eight directions. */
const bitsOf = (symbol) => (data.codes ? data.codes[symbol].toString(2).padStart(3, "0") : `${symbol & 1}, ${symbol >> 1}`);

const number = new Map(places.names.map((name, i) => [name.toLowerCase(), i]));
let hovered = -1, selected = -1, spot = null;
/** What a press at a pixel takes hold of instead of the map: a function that moves it there (texture frame), or null. */
let grab = () => null;
/** More lines about a part, and what else shows which one is selected. */
const moreLines = [], selectedToo = [];
/** What is drawn once more before printing. */
const forPaper = [];

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
  const tape = data.tapes ? data.tapes[places.tapes[i]] : null, [firstColumn, firstRow] = (tape ?? data).origin;
  const how = SYMBOL_WORDS[letter] + (tape?.turned ? " on its tape, which lies turned" : "");
  const lines = [
    ["designator", places.names[i]],
    ["column, row", `${c}, ${r}`],
    ["code index", `${firstColumn + c}, ${firstRow + r}`],
    ["symbol", `${letter}, ${how}; bits ${bitsOf(places.symbols[i])}`],
  ];
  if (tape) lines.unshift(["tape", tape.name]);
  else lines.push(["texture x, y", `${mm(tx, 4)}, ${mm(ty, 4)} mm`]);
  if (places.model) lines.push(["on the part", `${[0, 1, 2].map((axis) => mm(places.model[3 * i + axis])).join(", ")} mm`]);
  else lines.push([tape ? "panel x, y" : "board x, y", `${mm(x, 4)}, ${mm(y, 4)} mm`], ["rotation", `${Number(places.turns[i].toFixed(4))}°`]);
  return lines.concat(...moreLines.map((more) => more(i)));
}

function showPart() {
  const i = hovered >= 0 ? hovered : selected;
  listInto("part", i >= 0 ? describe(i) : [["", "Point at a part, or click it to keep it."]]);
}

function select(i, { look = false, say = false } = {}) {
  selected = i;
  hovered = -1;
  showPart();
  for (const tell of selectedToo) tell();
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
  const radius = Math.max(9, 1.15 * data.reach_mm * view.k + 2);
  if (selected >= 0) ring(brush, places.xy[2 * selected], places.xy[2 * selected + 1], radius, "#0072b2", 3);
  if (hovered >= 0 && hovered !== selected) ring(brush, places.xy[2 * hovered], places.xy[2 * hovered + 1], radius, "#1b1f24", 1.5);
  if (spot) ring(brush, spot.x, spot.y, 12, "#d55e00", 3);
});

// Search

function find(text) {
  const wish = text.trim().toLowerCase();
  const point = columns ? wish.match(/^(\d{1,7})\s*[,;\s]\s*(\d{1,7})$/) : null;
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

function addSwitch(layer) {
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
for (const layer of data.layers) addSwitch(layer);

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
  grip = held.size === 1 ? grab(u, v) : null;
  canvas.classList.add("busy");
});

canvas.addEventListener("pointermove", (event) => {
  const [u, v] = spot2(event), before = held.get(event.pointerId);
  const [x, y] = toTexture(boardX(u), boardY(v)), board = `${mm(boardX(u))}, ${mm(boardY(v))} mm`;
  element("pointer").textContent = data.tapes ? `panel ${board}` : `texture ${mm(x)}, ${mm(y)} mm${places.model ? "" : `; board ${board}`}`;
  if (!before) {
    canvas.classList.toggle("on-window", grab(u, v) !== null);
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
    if (grip) grip(x, y);
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
  element("pointer").textContent = "point at the map";
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
  if (arrow && columns && selected >= 0 && !event.shiftKey) {
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
