// The solid: triangles with depth in software, lit from the upper left; it needs no graphics card.
function solidView(solid, screen) {
  const focus = solid.texture; // of a part of the user's own: the view begins there
  const vertices = new Uint16Array(bytesOf(solid.vertices)), total = solid.shown, packed = bytesOf(solid.faces);
  const faces = packed.byteLength === 12 * total ? new Uint32Array(packed) : new Uint16Array(packed);
  const corners = new Float32Array(9 * total), normals = new Float32Array(3 * total);
  const middle = [0, 1, 2].map((axis) => {
    let low = Infinity, high = -Infinity;
    for (let i = axis; i < vertices.length; i += 3) {
      low = Math.min(low, vertices[i]);
      high = Math.max(high, vertices[i]);
    }
    if (!focus) return { middle: (low + high) / 2, half: ((high - low) / 2) * solid.step_mm[axis] };
    return { middle: (focus.middle_mm[axis] - solid.low_mm[axis]) / solid.step_mm[axis], half: focus.reach_mm };
  });
  for (let i = 0; i < corners.length; i++) {
    const axis = i % 3, vertex = faces[(i - axis) / 3];
    corners[i] = (vertices[3 * vertex + axis] - middle[axis].middle) * solid.step_mm[axis];
  }
  for (let t = 0; t < total; t++) {
    const p = 9 * t, c = corners;
    const ax = c[p + 3] - c[p], ay = c[p + 4] - c[p + 1], az = c[p + 5] - c[p + 2];
    const bx = c[p + 6] - c[p], by = c[p + 7] - c[p + 1], bz = c[p + 8] - c[p + 2];
    const nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx, length = Math.hypot(nx, ny, nz) || 1;
    normals.set([nx / length, ny / length, nz / length], 3 * t);
  }
  const radius = Math.hypot(...middle.map((axis) => axis.half)) || 1;
  const degrees = (rad) => (rad * 180) / Math.PI;
  const start = { turn: 25, tilt: 50, zoom: 1, x: 0, y: 0 };
  if (focus) {
    const [nx, ny, nz] = focus.normal, flat = Math.hypot(nx, ny);
    start.turn = flat > 1e-6 ? degrees(Math.atan2(nx, -ny)) : 0;
    start.tilt = Math.max(0, Math.min(180, degrees(Math.atan2(flat, nz)) + 35));
  }
  const state = { ...start };
  const pen = screen.getContext("2d");
  let waiting = false, visible = false;

  /** Rows of the camera: right, up, towards the viewer. */
  function camera() {
    const a = (state.turn * Math.PI) / 180, b = (state.tilt * Math.PI) / 180;
    return [
      [Math.cos(a), Math.sin(a), 0],
      [-Math.sin(a) * Math.cos(b), Math.cos(a) * Math.cos(b), Math.sin(b)],
      [Math.sin(a) * Math.sin(b), -Math.cos(a) * Math.sin(b), Math.cos(b)],
    ];
  }

  /** How far the solid reaches to the right and up in the first view: it then fills the canvas. */
  function fit(w, h, [right, up]) {
    if (focus) return (0.47 * Math.min(w, h)) / focus.reach_mm;
    const reach = (row) => row.reduce((sum, value, axis) => sum + Math.abs(value) * middle[axis].half, 0);
    return 0.94 * Math.min(w / 2 / (reach(right) || 1), h / 2 / (reach(up) || 1), (Math.max(w, h) / radius) * 4);
  }

  function draw() {
    waiting = false;
    const box = screen.getBoundingClientRect(), ratio = Math.min(1.5, window.devicePixelRatio || 1);
    const w = (screen.width = Math.max(1, Math.round(box.width * ratio)));
    const h = (screen.height = Math.max(1, Math.round(box.height * ratio)));
    const image = pen.createImageData(w, h), pixels = new Uint32Array(image.data.buffer), depth = new Float32Array(w * h).fill(-Infinity);
    const rows = camera(), [r, u, d] = rows;
    const scale = fit(w, h, rows) * state.zoom, offX = w / 2 + state.x * w, offY = h / 2 + state.y * h;
    const light = [-0.45, 0.6, 0.66];
    const s = new Float32Array(9);
    for (let t = 0; t < total; t++) {
      const nx = normals[3 * t], ny = normals[3 * t + 1], nz = normals[3 * t + 2];
      const facing = nx * d[0] + ny * d[1] + nz * d[2];
      if (facing <= 0) continue;
      for (let p = 0; p < 9; p += 3) {
        const x = corners[9 * t + p], y = corners[9 * t + p + 1], z = corners[9 * t + p + 2];
        s[p] = (x * r[0] + y * r[1] + z * r[2]) * scale + offX;
        s[p + 1] = offY - (x * u[0] + y * u[1] + z * u[2]) * scale;
        s[p + 2] = x * d[0] + y * d[1] + z * d[2];
      }
      const lit = (nx * r[0] + ny * r[1] + nz * r[2]) * light[0] + (nx * u[0] + ny * u[1] + nz * u[2]) * light[1] + facing * light[2];
      const shade = Math.min(1, 0.42 + 0.14 * facing + 0.5 * Math.max(0, lit));
      const colour = (0xff000000 | ((226 * shade) << 16) | ((218 * shade) << 8) | (210 * shade)) >>> 0;
      fill(s, colour, pixels, depth, w, h);
    }
    pen.putImageData(image, 0, 0);
    if (places.model && selected >= 0) {
      const at = [0, 1, 2].map((axis) => places.model[3 * selected + axis] - solid.low_mm[axis] - middle[axis].middle * solid.step_mm[axis]);
      const [x, y, z] = rows.map((row) => row[0] * at[0] + row[1] * at[1] + row[2] * at[2]);
      const px = x * scale + offX, py = offY - y * scale;
      if (!(depth[Math.round(py) * w + Math.round(px)] > z + data.reach_mm)) {
        for (const [ink, line] of [["#ffffff", 5.5], ["#0072b2", 3]]) {
          pen.strokeStyle = ink;
          pen.lineWidth = line * ratio;
          pen.beginPath();
          pen.arc(px, py, Math.max(9 * ratio, 1.15 * data.reach_mm * scale + 2), 0, 2 * Math.PI);
          pen.stroke();
        }
      }
    }
    screen.setAttribute("aria-busy", "false");
  }

  function fill(s, colour, pixels, depth, w, h) {
    const low = Math.max(0, Math.ceil(Math.min(s[1], s[4], s[7]) - 0.5)), high = Math.min(h - 1, Math.floor(Math.max(s[1], s[4], s[7]) - 0.5));
    const area = (s[3] - s[0]) * (s[7] - s[1]) - (s[6] - s[0]) * (s[4] - s[1]);
    if (area === 0) return;
    const zx = ((s[5] - s[2]) * (s[7] - s[1]) - (s[8] - s[2]) * (s[4] - s[1])) / area;
    const zy = ((s[8] - s[2]) * (s[3] - s[0]) - (s[5] - s[2]) * (s[6] - s[0])) / area;
    for (let row = low; row <= high; row++) {
      const y = row + 0.5;
      let from = Infinity, to = -Infinity;
      for (let e = 0; e < 3; e++) {
        const a = 3 * e, b = 3 * ((e + 1) % 3), ya = s[a + 1], yb = s[b + 1];
        if (ya === yb || y < Math.min(ya, yb) || y > Math.max(ya, yb)) continue;
        const x = s[a] + ((y - ya) / (yb - ya)) * (s[b] - s[a]);
        from = Math.min(from, x);
        to = Math.max(to, x);
      }
      const first = Math.max(0, Math.ceil(from - 0.5)), last = Math.min(w - 1, Math.floor(to - 0.5));
      let z = s[2] + zx * (first + 0.5 - s[0]) + zy * (y - s[1]);
      for (let i = row * w + first; i <= row * w + last; i++, z += zx) {
        if (z > depth[i]) {
          depth[i] = z;
          pixels[i] = colour;
        }
      }
    }
  }

  const later = () => {
    if (waiting || !visible) return;
    waiting = true;
    screen.setAttribute("aria-busy", "true");
    requestAnimationFrame(draw);
  };
  const change = (values) => {
    Object.assign(state, values);
    state.tilt = Math.min(180, Math.max(0, state.tilt));
    state.zoom = Math.min(60, Math.max(0.3, state.zoom));
    later();
  };
  const drag = (dx, dy, shift) => {
    const box = screen.getBoundingClientRect();
    if (shift) change({ x: state.x + dx / box.width, y: state.y + dy / box.height });
    else change({ turn: state.turn - dx * 0.4, tilt: state.tilt - dy * 0.4 });
  };
  screen.addEventListener("pointerdown", (event) => screen.setPointerCapture(event.pointerId));
  screen.addEventListener("pointermove", (event) => {
    if (event.buttons & 1) drag(event.movementX, event.movementY, event.shiftKey);
  });
  screen.addEventListener("wheel", (event) => {
    if (!event.ctrlKey) return;
    event.preventDefault();
    change({ zoom: state.zoom * Math.exp(-event.deltaY * 0.002) });
  }, { passive: false });
  screen.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-20, 0], ArrowRight: [20, 0], ArrowUp: [0, -20], ArrowDown: [0, 20] }[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (step) drag(...step, event.shiftKey);
    else if (event.key === "+" || event.key === "=") change({ zoom: state.zoom * 1.25 });
    else if (event.key === "-") change({ zoom: state.zoom / 1.25 });
    else if (event.key === "0") change(start);
    else return;
    event.preventDefault();
  });
  new IntersectionObserver(([entry]) => {
    visible = entry.isIntersecting;
    later();
  }).observe(screen);
  new ResizeObserver(later).observe(screen);
  return { draw, later };
}

const solid = data.solid && element("shaded") ? solidView(data.solid, element("shaded")) : null;
if (solid) {
  const { shown: some, total } = data.solid, grouped = (value) => value.toString().replace(/\B(?=(\d{3})+$)/g, ",");
  element("shaded-what").textContent = some < total
    ? `A piece of the written STL: ${grouped(some)} of its ${grouped(total)} triangles.`
    : `The written STL, ${grouped(total)} triangles.`;
  selectedToo.push(solid.later);
  forPaper.push(solid.draw);
}
