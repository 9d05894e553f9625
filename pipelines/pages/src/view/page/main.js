// The page: what is shown, what people do to it, and the order in which things follow from each other:
// sun -> shadows -> colours -> picture.

const byId = (id) => document.getElementById(id);
const MINUTE = 60000, DAY = 86400000;

function begin(scene, albedo) {
  const started = performance.now();
  const field = readField(scene);
  const { width, height, known } = field;
  const sweep = sweeper(field, scene.place.east, scene.place.north, scene.caster);
  const app = {
    scene, field, sweep, albedo,
    visible: new Uint8Array(field.z.length),
    sun: { az: 0, el: 0 }, sunward: [0, -1], time: null, day: Date.UTC(new Date().getUTCFullYear(), 5, 21), date: null,
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
  app.layerOf = (id) => layers.find((layer) => layer.id === id);

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
  app.current = () => (app.mode === "plan" ? plan : oblique);
  Object.assign(app, { layers, front, back, view, stage, plan, oblique, split: 0.5, dragging: false, drawing: false, playing: 0 });

  // From a change to the picture.
  const stale = { shadows: true, colours: true, sky: true };
  let asked = false;
  app.ask = (...what) => {
    what.forEach((key) => (stale[key] = true));
    if (!asked) { asked = true; requestAnimationFrame(() => { asked = false; render(); }); }
  };
  app.redraw = () => app.ask();

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
    app.draw();
    if (stale.sky) { dome.draw(); app.say(); stale.sky = false; }
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
  dark.addEventListener("change", () => app.ask("colours", "sky"));

  app.size = () => [stage.clientWidth, stage.clientHeight];
  app.draw = () => {
    const [w, h] = app.size();
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    if (view.width !== Math.round(w * ratio) || view.height !== Math.round(h * ratio)) {
      view.width = Math.round(w * ratio);
      view.height = Math.round(h * ratio);
    }
    const c = view.getContext("2d");
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, w, h);
    if (app.current().fitted) app.fit();
    const two = back.layer ? back : null, at = app.split * w;
    if (app.mode === "plan") plan.draw(c, w, h, front.canvas, two && two.canvas, at);
    else oblique.draw(c, w, h, front.image.data, two && two.image.data, at, app.sunward, app.dragging ? 1 : Math.min(ratio, 1.5), dark.matches ? [58, 61, 68] : [196, 190, 178]);
    drawLine(c, w, h);
    bearings(w);
    byId("divider").hidden = byId("labels").hidden = !two;
    if (two) byId("divider").style.left = `${at}px`;
  };

  app.fit = () => {
    const [w, h] = app.size();
    const wide = w > 700;
    app.current().fit(w, h, wide ? [28, 28, 84, 64] : [10, 10, 92, 34]);
  };

  /// True north, and a bar of a round length, over the plan.
  function bearings(w) {
    byId("bearings").hidden = app.mode !== "plan";
    const [right, down] = scene.place.north;
    byId("north").style.transform = `rotate(${Math.atan2(right, -down) / RAD}deg)`;
    const perPixel = scene.cell_m / plan.scale;
    const most = Math.min(160, 0.3 * w) * perPixel;
    const power = 10 ** Math.floor(Math.log10(most));
    const metres = [5, 2, 1].map((step) => step * power).find((step) => step <= most) ?? power;
    byId("scale").style.width = `${metres / perPixel}px`;
    byId("scale").textContent = metres < 1000 ? `${+metres.toPrecision(1)} m` : `${metres / 1000} km`;
  }

  function drawLine(c, w, h) {
    if (!app.line) return;
    const ends = app.line.map(([x, y]) => app.current().toPixel(x, y, w, h));
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

  sunAndWords(app);
  layerChoice(app);
  controls(app);
  pointing(app);
  keys(app);
  pictureFile(app);
  address(app);

  const lit = scene.albedo ? "Colours are the model's albedo in its light: sunlight where the sun is seen, and skylight. " : "";
  const agreed = scene.dates.some((date) => date.agreement) ? "The number beside a date is the share of shadows on which this page and the model agree (intersection over union). " : "";
  byId("notes").textContent = `${lit}${agreed}Shadows are cast by the heights, live, with the half-shade of the sun's disc. Striped cells are unknown: they throw no shadow and have none. ` +
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
  app.follow();
  render();
  app.ready = performance.now() - started;
  if (app.words().has("report")) writeReport(app);
  document.documentElement.dataset.ready = "1";
}

// Unpacking begins at once and takes turns that are over before `load`, so that a program that looks at the page then sees it complete.
const sceneOfPage = JSON.parse(byId("scene").textContent);
const albedoOfPage = sceneOfPage.albedo ? pictureOf(sceneOfPage.albedo.picture) : null;
const loaded = new Promise((done) => addEventListener("load", done));
Promise.all([unpack(sceneOfPage), loaded])
  .then(([scene]) => begin(scene, albedoOfPage))
  .catch((error) => {
    byId("said").textContent = `This browser cannot show the page: ${error.message}`;
    byId("report").textContent = JSON.stringify({ error: String(error) });
  });
