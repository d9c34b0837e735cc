// The map: shapes are drawn into a picture a little larger than the view, some at a time so that no frame waits for them;
// moving and zooming show that picture moved and scaled until the next one is there.
const MARGIN = 0.2;
const BATCH = 120;
const LEAST_SCALE = 0.02, MOST_SCALE = 2000;
const SYMBOLS = ["#0072b2", "#009e73", "#e69f00", "#d55e00", "#56b4e9", "#6a51a3", "#8c6d1f", "#cc79a7"];

const shapes = data.shapes.map((shape) => ({
  ...shape,
  stamps: shape.stamps.map((stamp) => ({ outline: floats(stamp.outline), xy: stamp.xy === null ? places.xy : floats(stamp.xy) })),
  polygons: pathsOf(shape.polygons),
  lines: pathsOf(shape.lines),
}));
const shown = new Set(data.layers.filter((layer) => layer.shown).map((layer) => layer.id));

const canvas = element("board"), pen = canvas.getContext("2d");
const view = { x: 0, y: 0, k: 1 };
let width = 1, height = 1, ratio = 1;
let picture = null, spare = null, job = null, wanted = 0, lastMove = 0, lastFrame = 0, slice = 5, ticking = false;
const overlays = [];
/** Layers that are drawn above the written ones, by their switches. */
const painters = new Map();

const screenX = (x) => (x - view.x) * view.k + width / 2;
const screenY = (y) => (view.y - y) * view.k + height / 2;
const boardX = (u) => (u - width / 2) / view.k + view.x;
const boardY = (v) => view.y - (v - height / 2) / view.k;

/** An empty canvas of a size: the one that the last picture but one was drawn on, where it fits. */
function emptySheet(w, h) {
  const sheet = spare !== null && spare.width === w && spare.height === h ? spare : document.createElement("canvas");
  if (sheet === spare) sheet.getContext("2d").clearRect(0, 0, w, h);
  else {
    sheet.width = w;
    sheet.height = h;
  }
  spare = null;
  return sheet;
}

/** A path of an outline at several places; few of its corners where it is small. */
function* stampPaths(brush, stamp, k, mapX, mapY, w, h) {
  const outline = stamp.outline, xy = stamp.xy, points = outline.length / 2;
  let reach = 0;
  for (const value of outline) reach = Math.max(reach, Math.abs(value));
  reach *= k;
  const step = reach < 1.5 ? Math.max(1, points >> 2) : reach < 6 ? Math.max(1, points >> 3) : 1;
  const corners = [];
  for (let p = 0; p < points; p += step) corners.push(outline[2 * p] * k, -outline[2 * p + 1] * k);
  let inBatch = 0;
  brush.beginPath();
  for (let i = 0; i < xy.length; i += 2) {
    const u = mapX(xy[i]), v = mapY(xy[i + 1]);
    if (u < -reach || v < -reach || u > w + reach || v > h + reach) continue;
    brush.moveTo(u + corners[0], v + corners[1]);
    for (let c = 2; c < corners.length; c += 2) brush.lineTo(u + corners[c], v + corners[c + 1]);
    brush.closePath();
    if (++inBatch === BATCH) {
      yield;
      inBatch = 0;
      brush.beginPath();
    }
  }
  if (inBatch) yield;
}

function tracePath(brush, path, mapX, mapY, closed) {
  brush.moveTo(mapX(path[0]), mapY(path[1]));
  for (let i = 2; i < path.length; i += 2) brush.lineTo(mapX(path[i]), mapY(path[i + 1]));
  if (closed) brush.closePath();
}

/** Fill and stroke what the brush has traced, in the shape's colours. */
function ink(brush, shape, k) {
  brush.globalCompositeOperation = shape.fill === "" ? "destination-out" : "source-over";
  if (shape.fill !== null) {
    brush.fillStyle = shape.fill || "#000000";
    brush.fill();
  }
  brush.globalCompositeOperation = "source-over";
  if (shape.stroke !== null && shape.stroke_mm * k > 0.2) {
    brush.strokeStyle = shape.stroke;
    brush.lineWidth = shape.stroke_mm * k;
    brush.lineCap = brush.lineJoin = "round";
    brush.stroke();
  }
}

function* paintShape(brush, shape, k, mapX, mapY, w, h) {
  if (shape.polygons.length) {
    brush.beginPath();
    for (const path of shape.polygons) tracePath(brush, path, mapX, mapY, true);
    ink(brush, shape, k);
    yield;
  }
  for (let i = 0; i < shape.lines.length; i += BATCH) {
    brush.beginPath();
    for (const path of shape.lines.slice(i, i + BATCH)) tracePath(brush, path, mapX, mapY, false);
    ink(brush, { ...shape, fill: null }, k);
    yield;
  }
  for (const stamp of shape.stamps) {
    for (const _ of stampPaths(brush, stamp, k, mapX, mapY, w, h)) {
      ink(brush, shape, k);
      yield;
    }
  }
}

function* paintGrid(brush, k, mapX, mapY) {
  if (pitch * k < 3) return;
  brush.strokeStyle = "rgba(0, 0, 0, 0.75)";
  brush.lineWidth = 1;
  for (const [colour, offset] of [["rgba(255, 255, 255, 0.75)", 1], ["rgba(0, 0, 0, 0.75)", 0]]) {
    brush.strokeStyle = colour;
    brush.beginPath();
    for (let c = 0; c < columns; c++) {
      const u = Math.round(mapX(originX + c * pitch)) + 0.5 + offset;
      brush.moveTo(u, mapY(originY + pitch / 2));
      brush.lineTo(u, mapY(originY - (rows - 0.5) * pitch));
    }
    for (let r = 0; r < rows; r++) {
      const v = Math.round(mapY(originY - r * pitch)) + 0.5 + offset;
      brush.moveTo(mapX(originX - pitch / 2), v);
      brush.lineTo(mapX(originX + (columns - 0.5) * pitch), v);
    }
    brush.stroke();
    yield;
  }
}

/** An arrow from its grid point for every part, and its letter where there is room. */
function* paintSymbols(brush, k, mapX, mapY, w, h) {
  const size = 0.3 * pitch * k, letters = pitch * k > 26;
  const half = Math.SQRT1_2;
  const along = [[0, -1], [-1, 0], [1, 0], [0, 1], [half, -half], [-half, -half], [half, half], [-half, half]];
  brush.lineWidth = Math.max(1, size / 8);
  brush.lineJoin = "round";
  brush.font = `600 ${Math.round(0.24 * pitch * k)}px system-ui, sans-serif`;
  brush.textAlign = "center";
  brush.textBaseline = "middle";
  for (let symbol = 0; symbol < data.letters.length; symbol++) {
    const [dx, dy] = along[symbol];
    let inBatch = 0;
    brush.beginPath();
    const finish = () => {
      brush.fillStyle = SYMBOLS[symbol];
      brush.strokeStyle = "#ffffff";
      brush.stroke();
      brush.fill();
    };
    for (let i = 0; i < count; i++) {
      if (places.symbols[i] !== symbol) continue;
      const u = mapX(places.xy[2 * i]), v = mapY(places.xy[2 * i + 1]);
      if (u < -size || v < -size || u > w + size || v > h + size) continue;
      brush.moveTo(u + dx * size, v + dy * size);
      brush.lineTo(u - (dx + dy) * 0.6 * size, v - (dy - dx) * 0.6 * size);
      brush.lineTo(u - (dx - dy) * 0.6 * size, v - (dy + dx) * 0.6 * size);
      brush.closePath();
      if (++inBatch === BATCH) {
        finish();
        yield;
        inBatch = 0;
        brush.beginPath();
      }
    }
    finish();
    yield;
    for (let i = 0; letters && i < count; i++) {
      if (places.symbols[i] !== symbol) continue;
      const u = mapX(places.xy[2 * i]) - dx * 0.12 * size, v = mapY(places.xy[2 * i + 1]) - dy * 0.12 * size;
      if (u < 0 || v < 0 || u > w || v > h) continue;
      brush.fillStyle = "#ffffff";
      brush.fillText(data.letters[symbol], u, v);
      if (++inBatch % 60 === 0) yield;
    }
  }
}

painters.set("grid", paintGrid);
painters.set("symbols", paintSymbols);

/** Draw everything that is switched on into a new picture of the present view, step by step. */
function* paint() {
  const w = Math.ceil(width * (1 + 2 * MARGIN)), h = Math.ceil(height * (1 + 2 * MARGIN));
  const next = { x: view.x, y: view.y, k: view.k, w, h, ratio, sheet: emptySheet(Math.ceil(w * ratio), Math.ceil(h * ratio)) };
  const brush = next.sheet.getContext("2d");
  brush.setTransform(ratio, 0, 0, ratio, 0, 0);
  yield;
  const mapX = (x) => (x - next.x) * next.k + w / 2, mapY = (y) => (next.y - y) * next.k + h / 2;
  for (const shape of shapes) {
    if (shown.has(shape.layer)) yield* paintShape(brush, shape, next.k, mapX, mapY, w, h);
  }
  for (const [layer, painter] of painters) if (shown.has(layer)) yield* painter(brush, next.k, mapX, mapY, w, h);
  spare = picture && picture.sheet;
  picture = next;
}

function isStale() {
  return picture === null || picture.of !== wanted || picture.x !== view.x || picture.y !== view.y || picture.k !== view.k;
}

/** Whether the picture shows too little of the view, or too coarsely, to wait for the end of the movement. */
function isFar() {
  if (picture === null) return true;
  const zoom = view.k / picture.k, shift = Math.max(Math.abs(view.x - picture.x) / width, Math.abs(view.y - picture.y) / height);
  return zoom > 1.6 || zoom < 0.8 || shift * picture.k > MARGIN * 0.8;
}

function startJob() {
  const of = wanted;
  job = (function* () {
    yield* paint();
    picture.of = of;
  })();
}

function work(milliseconds) {
  const end = performance.now() + milliseconds;
  while (job && performance.now() < end) if (job.next().done) job = null;
}

function frame(now) {
  const waited = now - lastFrame;
  lastFrame = now;
  slice = waited > 34 ? Math.max(1, slice * 0.6) : Math.min(7, slice * 1.15);
  if (!job && isStale() && (isFar() || now - lastMove > 90 || picture.of !== wanted)) startJob();
  work(slice);
  show();
  ticking = job !== null || isStale();
  canvas.setAttribute("aria-busy", String(ticking));
  if (ticking) requestAnimationFrame(frame);
}

function refresh() {
  if (ticking) return;
  ticking = true;
  canvas.setAttribute("aria-busy", "true");
  lastFrame = performance.now();
  requestAnimationFrame(frame);
}

function show() {
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  if (picture) {
    const zoom = view.k / picture.k;
    pen.imageSmoothingQuality = "low";
    const w = (picture.sheet.width / picture.ratio) * zoom, h = (picture.sheet.height / picture.ratio) * zoom;
    pen.drawImage(picture.sheet, screenX(picture.x) - (picture.w / 2) * zoom, screenY(picture.y) - (picture.h / 2) * zoom, w, h);
  }
  for (const overlay of overlays) overlay(pen);
  element("scale").textContent = `${view.k >= 10 ? view.k.toFixed(0) : view.k.toPrecision(2)} px/mm`;
}

/** The view has changed. */
function moved() {
  lastMove = performance.now();
  refresh();
}

/** What is drawn has changed. */
function changed() {
  wanted++;
  refresh();
}

function zoomAt(u, v, factor) {
  const x = boardX(u), y = boardY(v);
  view.k = Math.min(MOST_SCALE, Math.max(LEAST_SCALE, view.k * factor));
  view.x = x - (u - width / 2) / view.k;
  view.y = y + (v - height / 2) / view.k;
  keepNear();
  moved();
}

function panBy(u, v) {
  view.x -= u / view.k;
  view.y += v / view.k;
  keepNear();
  moved();
}

/** The middle of the view never leaves the tape. */
function keepNear() {
  view.x = Math.min(data.size_mm[0], Math.max(0, view.x));
  view.y = Math.min(data.size_mm[1], Math.max(0, view.y));
}

function showAll() {
  const [w, h] = data.size_mm;
  view.x = w / 2;
  view.y = h / 2;
  view.k = Math.min((width - 24) / w, (height - 24) / h);
  moved();
}

function lookAt(x, y, k = view.k) {
  view.x = x;
  view.y = y;
  view.k = k;
  keepNear();
  moved();
}

function resize() {
  const box = canvas.getBoundingClientRect(), first = width === 1;
  const finer = Math.min(2, window.devicePixelRatio || 1);
  if (box.width < 3 || box.height < 3 || (box.width - 2 === width && box.height - 2 === height && finer === ratio)) return;
  width = box.width - 2;
  height = box.height - 2;
  ratio = finer;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  if (first) showAll();
  changed();
}
