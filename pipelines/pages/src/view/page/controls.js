// What is pressed, slid and typed: dates, the day that plays, the sun, the views.

function controls(app) {
  const { scene, view } = app;

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
    button.onclick = () => { app.stop(); app.setDate(date); };
    byId("dates").append(button);
  }

  // Civil time: no file knows the zone of a place, so it is chosen; at first that of the browser.
  const own = Intl.DateTimeFormat().resolvedOptions().timeZone;
  const zones = new Set(["UTC", own, ...(Intl.supportedValuesOf?.("timeZone") ?? [])]);
  for (const zone of zones) byId("zone").append(new Option(zone.replaceAll("_", " "), zone, zone === own, zone === own));
  byId("zone").onchange = () => app.say();

  // Playing a day.
  app.playing = 0;
  app.stop = () => {
    cancelAnimationFrame(app.playing);
    app.playing = 0;
    byId("play").textContent = "▶";
  };
  app.play = () => {
    if (app.playing) return app.stop();
    byId("play").textContent = "❚❚";
    let before = performance.now();
    if (app.time === null || app.sun.el <= 0) app.setTime(firstLight());
    const step = (now) => {
      // Half an hour a second.
      const time = app.time + Math.min(200, now - before) * 1800;
      before = now;
      app.setTime(sunAt(time, scene.place.lat_deg, scene.place.lon_deg).el > 0 && time < app.day + (app.offset + 1440) * MINUTE ? time : firstLight());
      app.playing = requestAnimationFrame(step);
    };
    app.playing = requestAnimationFrame(step);
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
  app.setMode = (mode) => {
    app.mode = mode;
    byId("plan").setAttribute("aria-pressed", String(mode === "plan"));
    byId("oblique").setAttribute("aria-pressed", String(mode === "oblique"));
    app.ask();
  };
  byId("plan").onclick = () => app.setMode("plan");
  byId("oblique").onclick = () => app.setMode("oblique");
  byId("fit").onclick = () => { app.current().fitted = true; app.ask(); };
  app.setDrawing = (on) => {
    app.drawing = on;
    byId("draw").setAttribute("aria-pressed", String(on));
    view.style.cursor = on ? "crosshair" : "";
  };
  byId("draw").onclick = () => app.setDrawing(!app.drawing);
}
