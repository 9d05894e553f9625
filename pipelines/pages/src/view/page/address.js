// The address: what it asks for, and how it follows the sun.

function address(app) {
  const { scene, front, back } = app;

  app.words = () => new URLSearchParams((location.hash || location.search).slice(1).replace(/,(?=\w+=)/g, "&"));
  let written = null;
  app.follow = () => {
    const asked = app.words();
    if (asked.has("t") && !Number.isNaN(Date.parse(asked.get("t")))) app.setTime(Date.parse(asked.get("t")));
    else if (asked.has("az") && asked.has("el")) app.setAngles(Number(asked.get("az")), Number(asked.get("el")));
    else if (scene.dates.length) app.setDate(scene.dates[0]);
    else app.setTime(Date.UTC(new Date().getUTCFullYear(), 5, 21, 15) + app.offset * MINUTE);
    const layer = app.layerOf(asked.get("layer"));
    if (layer) { byId("layer").value = layer.id; app.choose(front, layer.id); }
    const against = app.layerOf(asked.get("swipe"));
    if (against) { byId("against").value = against.id; app.choose(back, against.id); }
    if (asked.get("view") === "oblique") app.setMode("oblique");
  };
  let later = 0;
  app.remember = () => {
    clearTimeout(later);
    // Not at every step of a drag: browsers refuse more than some dozens a second.
    later = setTimeout(() => {
      if (app.words().has("report") || app.playing) return;
      written = app.time === null ? `#az=${app.sun.az.toFixed(2)},el=${app.sun.el.toFixed(2)}` : `#t=${new Date(app.time).toISOString().slice(0, 16)}Z`;
      history.replaceState(null, "", written);
    }, 400);
  };
  addEventListener("hashchange", () => { if (location.hash !== written) app.follow(); });
  addEventListener("resize", () => app.ask("sky"));
}
