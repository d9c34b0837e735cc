// The sensor window: which parts a contact there would show, and what the certificate says of them.
const WINDOW_MM = [20, 15];
const WEAK = 16;
const sensor = { x: ((columns - 1) / 2) * pitch, y: ((rows - 1) / 2) * pitch, turn: 0, shown: true, seen: [], square: null };

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

grab = (u, v) => {
  if (!onWindow(u, v)) return null;
  const [x, y] = toTexture(boardX(u), boardY(v)), off = [sensor.x - x, sensor.y - y];
  return (toX, toY) => placeWindow(toX + off[0], toY + off[1]);
};
placeWindow(sensor.x, sensor.y);
for (const [id, title] of [["grid", "Grid"], ["symbols", "Symbols"]]) addSwitch({ id, title, shown: false });
