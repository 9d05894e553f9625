// The page: what is shown, what people do to it, and the order in which things follow from each other:
// sun -> shadows -> colours -> picture.

const byId = (id) => document.getElementById(id);
const MINUTE = 60000, DAY = 86400000;

function begin(scene, albedo) {
  const started = performance.now();
  const field = readField(scene);
  const { width, height, known } = field;
  const sweep = sweeper(field, scene.place.east, scene.place.north);
  const app = {
    scene, field, sweep, albedo,
    visible: new Uint8Array(field.z.length),
    sun: { az: 0, el: 0 }, sunward: [0, -1], time: null, day: 0, date: null,
    // Minutes from local mean time to UTC: the slider's noon is the place's.
    offset: -Math.round(scene.place.lon_deg * 4),
    hours: null, line: null, mode: "plan",
  };
  for (const date of scene.dates) {
    if (!date.mask) continue;
    date.traced = readMask(date.mask, field.z.length);
    sweep(date.azimuth_deg, date.elevation_deg, app.visible);
    date.agreement = agreement(app.visible, date.traced, known);
  }
  const layers = makeLayers(app);
  const layerOf = (id) => layers.find((layer) => layer.id === id);

  // The pictures of the cells: what is shown, and what it is compared with.
  const picture = () => {
    const canvas = document.createElement("canvas");
    canvas.width = width;
    canvas.height = height;
    const image = new ImageData(width, height);
    return { canvas, brush: canvas.getContext("2d"), image, layer: null };
  };
  const front = picture(), back = picture();
  const view = byId("view"), stage = byId("stage");
  const plan = planView(width, height), oblique = obliqueView(field, scene.cell_m);
  const current = () => (app.mode === "plan" ? plan : oblique);
  let split = 0.5, dragging = false;

  // From a change to the picture.
  const stale = { shadows: true, colours: true, sky: true };
  let asked = false;
  const ask = (...what) => {
    what.forEach((key) => (stale[key] = true));
    if (!asked) { asked = true; requestAnimationFrame(() => { asked = false; render(); }); }
  };
  app.redraw = () => ask();

  function render() {
    if (stale.shadows) {
      sweep(app.sun.az, app.sun.el, app.visible);
      const { east, north } = scene.place, a = app.sun.az * RAD;
      const toward = [0, 1].map((k) => Math.sin(a) * east[k] + Math.cos(a) * north[k]);
      const length = Math.hypot(...toward);
      app.sunward = toward.map((v) => v / length);
      stale.colours = stale.sky = true;
    }
    if (stale.colours) for (const one of [front, back]) if (one.layer && (one.layer.moves || one.stale !== false || !stale.shadows)) paint(one);
    stale.shadows = stale.colours = false;
    draw();
    if (stale.sky) { dome.draw(); say(); stale.sky = false; }
    drawProfile();
  }

  function paint(one) {
    one.layer.paint(one.image.data);
    paintUnknown(field, one.image.data, unknownColours());
    one.brush.putImageData(one.image, 0, 0);
    one.stale = false;
  }

  const dark = matchMedia("(prefers-color-scheme: dark)");
  const unknownColours = () => (dark.matches ? [[30, 33, 38], [44, 48, 55]] : [[233, 231, 226], [219, 216, 209]]);
  dark.addEventListener("change", () => ask("colours", "sky"));

  const size = () => [stage.clientWidth, stage.clientHeight];
  function draw() {
    const [w, h] = size();
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    if (view.width !== Math.round(w * ratio) || view.height !== Math.round(h * ratio)) {
      view.width = Math.round(w * ratio);
      view.height = Math.round(h * ratio);
    }
    const c = view.getContext("2d");
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, w, h);
    if (current().fitted) fit();
    const two = back.layer ? back : null, at = split * w;
    if (app.mode === "plan") plan.draw(c, w, h, front.canvas, two && two.canvas, at);
    else oblique.draw(c, w, h, front.image.data, two && two.image.data, at, app.sunward, dragging ? 1 : Math.min(ratio, 1.5), dark.matches ? [58, 61, 68] : [196, 190, 178]);
    drawLine(c, w, h);
    byId("divider").hidden = byId("labels").hidden = !two;
    if (two) byId("divider").style.left = `${at}px`;
  }

  function fit() {
    const [w, h] = size();
    const wide = w > 700;
    current().fit(w, h, wide ? [28, 28, 84, 64] : [10, 10, 92, 34]);
  }

  function drawLine(c, w, h) {
    if (!app.line) return;
    const ends = app.line.map(([x, y]) => current().toPixel(x, y, w, h));
    c.lineCap = "round";
    for (const [wide, colour] of [[5, "rgba(0,0,0,.55)"], [2.5, "#fff"]]) {
      c.lineWidth = wide;
      c.strokeStyle = c.fillStyle = colour;
      c.beginPath();
      ends.forEach(([x, y], k) => (k ? c.lineTo(x, y) : c.moveTo(x, y)));
      c.stroke();
      for (const [x, y] of ends) { c.beginPath(); c.arc(x, y, wide, 0, 2 * Math.PI); c.fill(); }
    }
  }

  // The sun.
  app.setTime = (time) => {
    app.time = time;
    const local = time - app.offset * MINUTE;
    const day = Math.floor(local / DAY) * DAY;
    if (day !== app.day) { app.day = day; forgetHours(); }
    app.sun = sunAt(time, scene.place.lat_deg, scene.place.lon_deg);
    app.date = null;
    moved();
  };
  app.setAngles = (az, el) => {
    app.time = null;
    app.sun = { az: ((az % 360) + 360) % 360, el: Math.max(-90, Math.min(90, el)) };
    app.date = null;
    moved();
  };
  const setDate = (date) => {
    const time = date.time ? Date.parse(date.time) : Date.parse(`${date.name}T12:00:00Z`);
    if (date.time) app.setTime(time);
    else {
      if (time === time) { app.day = Math.floor(time / DAY) * DAY; forgetHours(); }
      app.setAngles(date.azimuth_deg, date.elevation_deg);
    }
    // The very sun that the model was asked for.
    app.sun = { az: date.azimuth_deg, el: date.elevation_deg };
    app.date = date;
    moved();
  };
  function moved() {
    const { az, el } = app.sun;
    byId("azimuth").value = byId("azimuth-number").value = az.toFixed(1);
    byId("elevation").value = Math.max(0, el);
    byId("elevation-number").value = el.toFixed(1);
    byId("date").value = new Date(app.day).toISOString().slice(0, 10);
    if (app.time !== null) byId("hour").value = Math.round((app.time - app.offset * MINUTE - app.day) / MINUTE);
    for (const button of byId("dates")?.children ?? []) button.setAttribute("aria-pressed", String(button.date === app.date));
    ask("shadows");
    remember();
  }
  app.shadowShare = () => {
    let darkCells = 0, all = 0;
    for (let i = 0; i < known.length; i++) if (known[i]) { all++; if (app.visible[i] < 32) darkCells++; }
    return all ? darkCells / all : 0;
  };

  // What is said.
  const clock = (hours) => {
    const minutes = Math.round(hours * 60) % 1440;
    return `${String(Math.floor(minutes / 60)).padStart(2, "0")}:${String(minutes % 60).padStart(2, "0")}`;
  };
  const whereFrom = (az) => ["N", "NNE", "NE", "ENE", "E", "ESE", "SE", "SSE", "S", "SSW", "SW", "WSW", "W", "WNW", "NW", "NNW"][Math.round(az / 22.5) % 16];
  function say() {
    const { az, el } = app.sun;
    byId("azimuth-said").textContent = `${az.toFixed(1)}° ${whereFrom(az)}`;
    byId("elevation-said").textContent = `${el.toFixed(1)}°`;
    byId("shadow-said").textContent = el > 0 ? `${(100 * app.shadowShare()).toFixed(0)} %` : "night";
    const iso = app.time === null ? "" : new Date(app.time).toISOString();
    byId("utc").textContent = app.time === null ? "free sun, no time" : `${iso.slice(11, 16)} UTC`;
    byId("solar").textContent = app.time === null ? "" : `${clock(solarTime(app.time, scene.place.lon_deg))} solar time`;
    byId("said").textContent = app.time === null ? `Sun from ${whereFrom(az)}, ${el.toFixed(0)}° high` : `${iso.slice(0, 10)}, ${iso.slice(11, 16)} UTC`;
    const note = byId("agreement");
    if (note && app.date?.agreement) note.textContent = `Shadows of this page and those traced through the model agree to ${app.date.agreement.iou.toFixed(2)} (intersection over union).`;
    else if (note) note.textContent = "A date sets its sun. The number says how far the shadows of this page agree with those traced through the model (intersection over union).";
  }

  // Layers.
  const forgetHours = () => {
    app.hours = null;
    if ([front, back].some((one) => one.layer?.needs === "hours")) wantHours();
  };
  let hoursTurn = 0;
  async function wantHours() {
    const turn = ++hoursTurn;
    byId("legend-text").textContent = "counting …";
    const result = await sunHours(app, app.day + app.offset * MINUTE, () => turn === hoursTurn);
    if (!result || turn !== hoursTurn) return;
    app.hours = result;
    front.stale = back.stale = true;
    ask("colours");
    legend();
  }
  async function choose(one, id) {
    one.layer = id ? layerOf(id) : null;
    if (one.layer?.load) await one.layer.load();
    if (one.layer?.needs === "hours" && !app.hours) wantHours();
    if (id === "compare" && !app.date) setDate(nearestDate());
    one.stale = true;
    legend();
    ask("colours");
  }
  /// The date whose sun is next to the one there is.
  const nearestDate = () => {
    const toward = (az, el) => [Math.sin(az * RAD) * Math.cos(el * RAD), Math.cos(az * RAD) * Math.cos(el * RAD), Math.sin(el * RAD)];
    const here = toward(app.sun.az, app.sun.el);
    const near = (date) => toward(date.azimuth_deg, date.elevation_deg).reduce((sum, v, k) => sum + v * here[k], date.traced ? 0 : -4);
    return scene.dates.reduce((a, b) => (near(b) > near(a) ? b : a));
  };
  function legend() {
    const layer = [front.layer, back.layer].find((one) => one && (one.legend || one.words));
    byId("legend").hidden = !layer;
    byId("label-left").textContent = front.layer?.name ?? "";
    byId("label-right").textContent = back.layer?.name ?? "";
    if (!layer) return;
    const text = byId("legend-text"), bar = byId("legend-bar");
    bar.hidden = !layer.legend;
    if (layer.words) {
      text.replaceChildren(...layer.words.map(([colour, word]) => {
        const span = document.createElement("span"), mark = document.createElement("i");
        mark.style.background = colour;
        span.append(mark, word);
        return span;
      }));
      return;
    }
    const { ramp, low, high, unit, digits } = layer.legend;
    if (layer.needs === "hours" && !app.hours) { text.textContent = "counting …"; return; }
    const c = bar.getContext("2d"), table = rampTable(ramp);
    for (let x = 0; x < bar.width; x++) {
      const b = 3 * Math.round((255 * x) / (bar.width - 1));
      c.fillStyle = `rgb(${table[b]},${table[b + 1]},${table[b + 2]})`;
      c.fillRect(x, 0, 1, bar.height);
    }
    const most = layer.needs === "hours" ? app.hours.most : high;
    text.replaceChildren(...[low, most].map((value) => {
      const span = document.createElement("span");
      span.textContent = `${value.toFixed(digits)} ${unit}`;
      return span;
    }));
  }
  for (const [id, one, none] of [["layer", front, null], ["against", back, "nothing"]]) {
    const select = byId(id);
    if (none) select.add(new Option(none, ""));
    for (const layer of layers) select.add(new Option(layer.name, layer.id));
    select.onchange = () => choose(one, select.value);
  }
  front.layer = layers[0];

  // Dates.
  for (const date of scene.dates) {
    const button = document.createElement("button");
    button.date = date;
    const name = document.createElement("span");
    name.textContent = date.name.replace(/^sun_(\d+)_(\d+)$/, "sun $1° $2°");
    button.append(name);
    if (date.agreement) {
      const iou = document.createElement("small");
      iou.textContent = date.agreement.iou.toFixed(2);
      iou.title = "agreement with the shadows traced through the model";
      button.append(iou);
    }
    button.onclick = () => { app.stop(); setDate(date); };
    byId("dates").append(button);
  }

  // Playing a day.
  let playing = 0;
  app.stop = () => {
    cancelAnimationFrame(playing);
    playing = 0;
    byId("play").textContent = "▶";
  };
  app.play = () => {
    if (playing) return app.stop();
    byId("play").textContent = "❚❚";
    let before = performance.now();
    if (app.time === null || app.sun.el <= 0) app.setTime(firstLight());
    const step = (now) => {
      // Half an hour a second.
      const time = app.time + Math.min(200, now - before) * 1800;
      before = now;
      app.setTime(sunAt(time, scene.place.lat_deg, scene.place.lon_deg).el > 0 && time < app.day + (app.offset + 1440) * MINUTE ? time : firstLight());
      playing = requestAnimationFrame(step);
    };
    playing = requestAnimationFrame(step);
  };
  const firstLight = () => {
    const start = app.day + app.offset * MINUTE;
    for (let minute = 0; minute < 1440; minute += 5) if (sunAt(start + minute * MINUTE, scene.place.lat_deg, scene.place.lon_deg).el > 1) return start + minute * MINUTE;
    return start + 720 * MINUTE;
  };

  // Controls.
  byId("play").onclick = app.play;
  byId("hour").oninput = (event) => { app.stop(); app.setTime(app.day + (Number(event.target.value) + app.offset) * MINUTE); };
  byId("date").onchange = (event) => {
    const day = Date.parse(event.target.value);
    if (day !== day) return;
    app.stop();
    app.setTime(day + (app.time === null ? 720 + app.offset : 0) * MINUTE + (app.time === null ? 0 : app.time - app.day));
  };
  for (const id of ["azimuth", "azimuth-number", "elevation", "elevation-number"]) {
    byId(id).oninput = (event) => {
      const value = Number(event.target.value);
      if (event.target.value === "" || value !== value) return;
      app.stop();
      if (id.startsWith("az")) app.setAngles(value, app.sun.el);
      else app.setAngles(app.sun.az, value);
    };
  }
  const setMode = (mode) => {
    app.mode = mode;
    byId("plan").setAttribute("aria-pressed", String(mode === "plan"));
    byId("oblique").setAttribute("aria-pressed", String(mode === "oblique"));
    ask();
  };
  byId("plan").onclick = () => setMode("plan");
  byId("oblique").onclick = () => setMode("oblique");
  byId("fit").onclick = () => { current().fitted = true; ask(); };
  let drawing = false;
  const setDrawing = (on) => {
    drawing = on;
    byId("draw").setAttribute("aria-pressed", String(on));
    view.style.cursor = on ? "crosshair" : "";
  };
  byId("draw").onclick = () => setDrawing(!drawing);

  // Where a pixel is.
  const cellAt = (px, py) => {
    const [w, h] = size();
    if (app.mode === "plan") return plan.toCell(px, py, w, h);
    const i = oblique.cellAt(px, py, w);
    return i < 0 ? null : [(i % width) + 0.5, Math.floor(i / width) + 0.5];
  };
  const mapAt = ([x, y]) => {
    const t = scene.transform;
    return [t[0] + t[1] * x + t[2] * y, t[3] + t[4] * x + t[5] * y];
  };
  const lonLatAt = ([x, y]) => {
    const weights = (t) => [2 * (t - 0.5) * (t - 1), -4 * t * (t - 1), 2 * t * (t - 0.5)];
    const u = weights(x / width), v = weights(y / height), out = [0, 0];
    for (let r = 0; r < 3; r++) for (let k = 0; k < 3; k++) for (const axis of [0, 1]) out[axis] += v[r] * u[k] * scene.place.nodes[3 * r + k][axis];
    return out;
  };
  function readOut(cell) {
    const out = byId("readout");
    if (!cell || cell[0] < 0 || cell[1] < 0 || cell[0] >= width || cell[1] >= height) { out.textContent = ""; return; }
    const i = Math.floor(cell[1]) * width + Math.floor(cell[0]);
    const [mx, my] = mapAt(cell), [lon, lat] = lonLatAt(cell);
    const parts = [known[i] ? `${field.z[i].toFixed(2)} m` : "unknown"];
    const value = front.layer?.value?.(i);
    if (known[i] && value) parts.push(value);
    if (known[i] && app.sun.el > 0) parts.push(app.visible[i] === 64 ? "sun" : app.visible[i] === 0 ? "shadow" : `${Math.round((100 * app.visible[i]) / 64)} % sun`);
    parts.push(scene.geographic ? "" : `E ${mx.toFixed(1)}  N ${my.toFixed(1)}`, `${Math.abs(lat).toFixed(6)}° ${lat < 0 ? "S" : "N"}  ${Math.abs(lon).toFixed(6)}° ${lon < 0 ? "W" : "E"}`);
    out.textContent = parts.filter(Boolean).join("   ·   ");
  }

  // Pointers: one moves, two zoom and turn.
  const pointers = new Map();
  let line = false, turning = false, pinch = null;
  const spot = (event) => { const box = view.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
  view.addEventListener("contextmenu", (event) => event.preventDefault());
  view.addEventListener("pointerdown", (event) => {
    view.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, spot(event));
    turning = event.button === 2 || event.shiftKey;
    pinch = null;
    dragging = true;
    readOut(cellAt(...spot(event)));
    if (drawing && pointers.size === 1) {
      const cell = cellAt(...spot(event));
      if (cell) { app.line = [cell, cell]; line = true; }
    }
  });
  view.addEventListener("pointermove", (event) => {
    const now = spot(event);
    if (!pointers.has(event.pointerId)) return readOut(cellAt(...now));
    const before = pointers.get(event.pointerId);
    pointers.set(event.pointerId, now);
    if (line && pointers.size === 1) {
      const cell = cellAt(...now);
      if (cell) app.line = [app.line[0], cell];
      readOut(cell);
      return ask();
    }
    if (pointers.size === 1) {
      if (turning && app.mode === "oblique") { oblique.turn((now[0] - before[0]) * 0.4, (now[1] - before[1]) * 0.3); if (oblique.fitted) fit(); }
      else current().move(now[0] - before[0], now[1] - before[1]);
    } else {
      const [a, b] = [...pointers.values()];
      const next = { length: Math.hypot(a[0] - b[0], a[1] - b[1]), angle: Math.atan2(b[1] - a[1], b[0] - a[0]), x: (a[0] + b[0]) / 2, y: (a[1] + b[1]) / 2 };
      if (pinch) {
        current().zoom(next.length / pinch.length, next.x, next.y, ...size());
        current().move(next.x - pinch.x, next.y - pinch.y);
        if (app.mode === "oblique") oblique.turn((next.angle - pinch.angle) / RAD, 0);
      }
      pinch = next;
    }
    ask();
  });
  const release = (event) => {
    pointers.delete(event.pointerId);
    pinch = null;
    if (line) { line = false; setDrawing(false); }
    dragging = pointers.size > 0;
    ask();
  };
  view.addEventListener("pointerup", release);
  view.addEventListener("pointercancel", release);
  view.addEventListener("wheel", (event) => {
    event.preventDefault();
    current().zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0016)), ...spot(event), ...size());
    ask();
  }, { passive: false });
  const divider = byId("divider");
  divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
  divider.addEventListener("pointermove", (event) => {
    if (!divider.hasPointerCapture(event.pointerId)) return;
    split = Math.max(0.02, Math.min(0.98, spot(event)[0] / stage.clientWidth));
    ask();
  });

  // Keys.
  addEventListener("keydown", (event) => {
    if (event.target.closest("input, select, summary") || event.ctrlKey || event.metaKey || event.altKey) return;
    const [w, h] = size();
    const step = event.shiftKey ? 60 : 10;
    const nudge = (minutes, az, el) => (app.time === null ? app.setAngles(app.sun.az + az, Math.max(0, app.sun.el + el)) : app.setTime(app.time + minutes * MINUTE));
    const actions = {
      ArrowLeft: () => nudge(-step, -step / 5, 0), ArrowRight: () => nudge(step, step / 5, 0),
      ArrowUp: () => nudge(1440, 0, step / 10), ArrowDown: () => nudge(-1440, 0, -step / 10),
      "+": () => current().zoom(1.25, w / 2, h / 2, w, h), "=": () => current().zoom(1.25, w / 2, h / 2, w, h),
      "-": () => current().zoom(0.8, w / 2, h / 2, w, h), 0: () => { current().fitted = true; },
      p: () => setMode("plan"), o: () => setMode("oblique"), l: () => setDrawing(!drawing), s: save,
      "[": () => oblique.turn(10, 0), "]": () => oblique.turn(-10, 0),
      " ": () => { if (event.target.tagName !== "BUTTON") app.play(); },
      Escape: () => { app.line = null; setDrawing(false); },
    };
    const action = actions[event.key] ?? actions[event.key.toLowerCase()];
    if (!action || (event.key === " " && event.target.tagName === "BUTTON")) return;
    event.preventDefault();
    if (event.key.startsWith("Arrow")) app.stop();
    action();
    ask();
  });

  // The view as a file.
  function save() {
    const [w, h] = size();
    dragging = false;
    draw();
    const name = `${scene.title}_${app.mode}_${app.time === null ? `sun_${app.sun.az.toFixed(0)}_${app.sun.el.toFixed(0)}` : new Date(app.time).toISOString().slice(0, 16).replace(":", "")}`.replace(/[^\w.-]+/g, "_");
    const offer = (blob, ending) => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = `${name}.${ending}`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    };
    view.toBlob((blob) => offer(blob, "png"));
    if (app.mode === "plan") offer(new Blob([app.worldFile()], { type: "text/plain" }), "pgw");
  }
  /// The world file of the plan as it is shown: from the centres of the picture's pixels to the map.
  app.worldFile = () => {
    const [w, h] = size();
    const t = scene.transform, perPixel = w / view.width / plan.scale;
    const [x, y] = plan.toCell(0.5 * (w / view.width), 0.5 * (h / view.height), w, h);
    const [mx, my] = mapAt([x, y]);
    return [t[1] * perPixel, t[4] * perPixel, t[2] * perPixel, t[5] * perPixel, mx, my].map((v) => v.toFixed(10)).join("\n") + "\n";
  };
  byId("save").onclick = save;

  // The address.
  const words = () => new URLSearchParams((location.hash || location.search).slice(1).replace(/,(?=\w+=)/g, "&"));
  let written = null;
  function follow() {
    const asked = words();
    if (asked.has("t") && !Number.isNaN(Date.parse(asked.get("t")))) app.setTime(Date.parse(asked.get("t")));
    else if (asked.has("az") && asked.has("el")) app.setAngles(Number(asked.get("az")), Number(asked.get("el")));
    else if (scene.dates.length) setDate(scene.dates[0]);
    else app.setTime(Date.UTC(new Date().getUTCFullYear(), 5, 21, 15) + app.offset * MINUTE);
    const layer = layerOf(asked.get("layer"));
    if (layer) { byId("layer").value = layer.id; choose(front, layer.id); }
    const against = layerOf(asked.get("swipe"));
    if (against) { byId("against").value = against.id; choose(back, against.id); }
    if (asked.get("view") === "oblique") setMode("oblique");
  }
  let later = 0;
  function remember() {
    clearTimeout(later);
    // Not at every step of a drag: browsers refuse more than some dozens a second.
    later = setTimeout(() => {
      if (words().has("report") || playing) return;
      written = app.time === null ? `#az=${app.sun.az.toFixed(2)},el=${app.sun.el.toFixed(2)}` : `#t=${new Date(app.time).toISOString().slice(0, 16)}Z`;
      history.replaceState(null, "", written);
    }, 400);
  }
  addEventListener("hashchange", () => { if (location.hash !== written) follow(); });
  addEventListener("resize", () => ask("sky"));

  const lit = scene.albedo ? "Colours are the model's albedo in its light: sunlight where the sun is seen, and skylight. " : "";
  byId("notes").textContent = `${lit}Shadows are cast by the heights, live, with the half-shade of the sun's disc. Striped cells are unknown: they throw no shadow and have none. ` +
    `${scene.width} × ${scene.height} cells of ${+scene.cell_m.toPrecision(3)} m, ${scene.crs_name}${scene.vertical_datum ? `, heights above ${scene.vertical_datum}` : ""}. heliosplat ${scene.version}`;
  const dome = skyDome(byId("dome"), app);
  const drawProfile = profileChart(app);
  window.heliosplat = {
    shadow: (az, el) => shadowMask(app, az, el),
    sun: (time) => { const { az, el } = sunAt(typeof time === "number" ? time : Date.parse(time), scene.place.lat_deg, scene.place.lon_deg); return { azimuth_deg: az, elevation_deg: el }; },
    sunHours: (date) => sunHours(app, Date.parse(date) + app.offset * MINUTE),
    heightAt: (col, row) => field.z[row * width + col],
    worldFile: app.worldFile,
  };
  follow();
  render();
  app.ready = performance.now() - started;
  if (words().has("report")) writeReport(app);
  document.documentElement.dataset.ready = "1";
}

// Everything is done within the `load` event: what looks at the page afterwards, a person or a program, sees it complete.
const sceneOfPage = JSON.parse(byId("scene").textContent);
const albedoOfPage = sceneOfPage.albedo ? pictureOf(sceneOfPage.albedo.picture) : null;
addEventListener("load", () => {
  try {
    begin(sceneOfPage, albedoOfPage);
  } catch (error) {
    byId("said").textContent = `This browser cannot show the page: ${error.message}`;
    byId("report").textContent = JSON.stringify({ error: String(error) });
  }
});
