// Places that inspect or survey measured: as-built.json, which the reader of the page opens; it never leaves the page.
const MOST_BUILT_BYTES = 64e6, AIM_PITCHES = 0.3;
let built = null;

/** A file's text as arrays over the parts; raises an Error with words for the page. */
function readBuilt(text) {
  const refuse = (why) => { throw new Error(`${why}; give as-built.json as inspect or survey wrote it`); };
  let content;
  try {
    content = JSON.parse(text);
  } catch {
    refuse("the file is no JSON");
  }
  if (content?.format !== "tactape-as-built/1") refuse("the file holds no measured places");
  if (content.tape !== data.name) refuse(`these places are of ${String(content.tape).slice(0, 64)}, not of ${data.name}`);
  const given = content.parts ?? {}, listed = Array.isArray(given.designator) ? given.designator : refuse("it lists no designators");
  const columnsOf = ["dx_mm", "dy_mm", "rotation_deg", "sigma_mm"];
  for (const key of [...columnsOf, "present"]) {
    const right = (value) => (key === "present" ? typeof value === "boolean" : Number.isFinite(value));
    if (!Array.isArray(given[key]) || given[key].length !== listed.length || !given[key].every(right)) refuse(`${key} is not one value for each designator`);
  }
  const row = new Int32Array(count).fill(-1);
  listed.forEach((name, k) => {
    const i = number.get(String(name).toLowerCase());
    if (i === undefined || row[i] >= 0) refuse(`${String(name).slice(0, 16)} is no part of this tape, or listed twice`);
    row[i] = k;
  });
  let sum = 0, there = 0;
  for (let k = 0; k < listed.length; k++) {
    if (!given.present[k]) continue;
    sum += given.dx_mm[k] ** 2 + given.dy_mm[k] ** 2;
    there++;
  }
  const scatter = there ? Math.sqrt(sum / (2 * there)) : 0;
  const times = Math.max(1, Math.min(100, Math.round((AIM_PITCHES * pitch) / (2 * scatter || pitch))));
  const kinds = Array.isArray(content.source) ? content.source.map((entry) => String(entry?.kind).slice(0, 16)) : [];
  const scale = Array.isArray(content.film?.scale) && content.film.scale.every(Number.isFinite) ? content.film.scale : [1, 1];
  return { ...given, row, scale, listed: listed.length, missing: listed.length - there, scatter, times, kinds };
}

/** An arrow from each part's nominal place along its deviation, enlarged, and a cross where a part is missing. */
function* paintBuilt(brush, k, mapX, mapY, w, h) {
  const cross = 0.3 * pitch * k, all = built;
  for (const [colour, extra] of [["#ffffff", 3], ["#d0006f", 0]]) {
    brush.strokeStyle = colour;
    brush.lineWidth = Math.max(1, 0.05 * pitch * k) + extra;
    brush.lineCap = "round";
    brush.beginPath();
    let inBatch = 0;
    for (let i = 0; i < count; i++) {
      const u = mapX(places.xy[2 * i]), v = mapY(places.xy[2 * i + 1]), row = all.row[i];
      if (row < 0 || u < -pitch * k || v < -pitch * k || u > w + pitch * k || v > h + pitch * k) continue;
      if (all.present[row]) {
        const du = all.dx_mm[row] * all.times * k, dv = -all.dy_mm[row] * all.times * k;
        brush.moveTo(u, v);
        brush.lineTo(u + du, v + dv);
        const head = 0.35 * Math.hypot(du, dv), angle = Math.atan2(dv, du);
        for (const side of [-0.45, 0.45]) {
          brush.moveTo(u + du, v + dv);
          brush.lineTo(u + du - head * Math.cos(angle + side), v + dv - head * Math.sin(angle + side));
        }
      } else {
        for (const lean of [-1, 1]) {
          brush.moveTo(u - cross, v - lean * cross);
          brush.lineTo(u + cross, v + lean * cross);
        }
      }
      if (++inBatch % BATCH === 0) {
        brush.stroke();
        yield;
        brush.beginPath();
      }
    }
    brush.stroke();
    yield;
  }
}
painters.set("built", paintBuilt);

moreLines.push((i) => {
  if (!built) return [];
  const k = built.row[i], um = (value) => (1000 * value).toFixed(1);
  if (k < 0) return [["measured", "not listed: as designed"]];
  if (!built.present[k]) return [["measured", "missing"]];
  return [
    ["off by x, y", `${um(built.dx_mm[k])}, ${um(built.dy_mm[k])} µm (σ ${um(built.sigma_mm[k])})`],
    ["turned by", `${built.rotation_deg[k].toFixed(2)}°`],
  ];
});

element("built-file")?.addEventListener("change", async (event) => {
  const [file] = event.target.files, said = element("built-said");
  if (!file) return;
  try {
    if (file.size > MOST_BUILT_BYTES) throw new Error("the file is too large for measured places");
    built = readBuilt(await file.text());
    const from = built.kinds.length ? `, from ${built.kinds.join(", ")}` : "";
    said.textContent = `${built.listed} of ${count} parts measured${from}: ${built.missing} missing, scatter ${(1000 * built.scatter).toFixed(1)} µm rms, apart from the film's stretch by ${built.scale.map((v) => (100 * (v - 1)).toFixed(3)).join(" and ")} %. Arrows are ${built.times} times as long. This page cannot tell whether the file is of this very kit: tactape-fab verify does.`;
    if (!element("layer-built")) addSwitch({ id: "built", title: "Measured", shown: true });
    shown.add("built");
    element("layer-built").checked = true;
  } catch (error) {
    built = null;
    shown.delete("built");
    if (element("layer-built")) element("layer-built").closest("label").remove();
    said.textContent = error.message;
  }
  showPart();
  changed();
});
