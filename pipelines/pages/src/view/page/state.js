// The sun that is shown, and what the page says of it.

function sunAndWords(app) {
  const { scene } = app;
  const { known } = app.field;

  // The sun.
  app.setTime = (time) => {
    app.time = time;
    const local = time - app.offset * MINUTE;
    const day = Math.floor(local / DAY) * DAY;
    if (day !== app.day) { app.day = day; app.forgetHours(); }
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
  app.setDate = (date) => {
    const time = date.time ? Date.parse(date.time) : Date.parse(`${date.name}T12:00:00Z`);
    if (date.time) app.setTime(time);
    else {
      if (time === time) { app.day = Math.floor(time / DAY) * DAY; app.forgetHours(); }
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
    app.ask("shadows");
    app.remember();
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
  app.say = () => {
    const { az, el } = app.sun;
    byId("azimuth-said").textContent = `${az.toFixed(1)}° ${whereFrom(az)}`;
    byId("elevation-said").textContent = `${el.toFixed(1)}°`;
    byId("shadow-said").textContent = el > 0 ? `${(100 * app.shadowShare()).toFixed(0)} %` : "night";
    const iso = app.time === null ? "" : new Date(app.time).toISOString();
    byId("utc").textContent = app.time === null ? "free sun, no time" : `${iso.slice(11, 16)} UTC`;
    const zone = byId("zone").value;
    byId("civil").textContent = app.time === null || zone === "UTC" ? "" : new Date(app.time).toLocaleTimeString("en-GB", { timeZone: zone, hour: "2-digit", minute: "2-digit", timeZoneName: "short" });
    byId("solar").textContent = app.time === null ? "" : `${clock(solarTime(app.time, scene.place.lon_deg))} solar time`;
    byId("said").textContent = app.time === null ? `Sun from ${whereFrom(az)}, ${el.toFixed(0)}° high` : `${iso.slice(0, 10)}, ${iso.slice(11, 16)} UTC`;
    const note = byId("agreement");
    if (note && app.date?.agreement) note.textContent = `Shadows of this page and those traced through the model agree to ${app.date.agreement.iou.toFixed(2)} (intersection over union).`;
    else if (note) note.textContent = "A date sets its sun.";
  };
}
