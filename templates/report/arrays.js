// The data of the page, and the arrays in it.
const data = JSON.parse(document.getElementById("data").textContent);

function bytesOf(text) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes.buffer;
}

const floats = (text) => new Float32Array(bytesOf(text));
const doubles = (text) => new Float64Array(bytesOf(text));
const element = (id) => document.getElementById(id);

/** Paths as arrays of x, y, x, y ... */
function pathsOf(packed) {
  const points = floats(packed.points), ends = new Uint32Array(bytesOf(packed.ends));
  return Array.from(ends, (end, i) => points.subarray(2 * (i ? ends[i - 1] : 0), 2 * end));
}

const places = {
  names: data.places.designators ? data.places.designators.split("\n") : [],
  xy: doubles(data.places.xy_mm),
  cells: new Int32Array(bytesOf(data.places.cells)),
  symbols: new Uint8Array(bytesOf(data.places.symbols)),
  turns: floats(data.places.rotation_deg),
  model: data.places.model_mm ? doubles(data.places.model_mm) : null,
  tapes: data.places.tapes ? new Uint16Array(bytesOf(data.places.tapes)) : null,
};
const count = places.names.length;
const [originX, originY] = data.texture_origin_mm ?? [0, 0];
const pitch = data.pitch_mm;

const toTexture = (x, y) => [x - originX, originY - y];
const toBoard = (x, y) => [x + originX, originY - y];
const mm = (value, digits = 3) => (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits);

/** Index of the part on each grid point, -1 where there is none; a panel has a grid in each of its tapes, and none here. */
const [columns, rows] = data.grid ?? [0, 0];
const partAt = new Int32Array(columns * rows).fill(-1);
for (let i = 0; i < count; i++) {
  const c = places.cells[2 * i], r = places.cells[2 * i + 1];
  if (c >= 0 && c < columns && r >= 0 && r < rows) partAt[r * columns + c] = i;
}
const onPoint = (c, r) => (c >= 0 && c < columns && r >= 0 && r < rows ? partAt[r * columns + c] : -1);
