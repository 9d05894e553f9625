// Which layers are shown and compared, and their legend.

function layerChoice(app) {
  const { scene, layers, front, back } = app;

  // Layers.
  app.forgetHours = () => {
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
    app.ask("colours");
    legend();
  }
  app.choose = async (one, id) => {
    one.layer = id ? app.layerOf(id) : null;
    if (one.layer?.load) await one.layer.load();
    if (one.layer?.needs === "hours" && !app.hours) wantHours();
    if (id === "compare" && !app.date) app.setDate(nearestDate());
    one.stale = true;
    legend();
    app.ask("colours");
  };
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
    select.onchange = () => app.choose(one, select.value);
  }
  front.layer = layers[0];
}
