// The sky as a disc, the zenith in the middle and north up: the way of the sun on this date, its hours, and the sun to be dragged.

function skyDome(canvas, app) {
  let size = 0;
  const place = ({ az, el }) => {
    const r = ((90 - el) / 90) * radius();
    return [size / 2 + r * Math.sin(az * RAD), size / 2 - r * Math.cos(az * RAD)];
  };
  const radius = () => size / 2 - 18;

  function path() {
    const points = [];
    const { lat_deg, lon_deg } = app.scene.place;
    for (let minute = 0; minute <= 1440; minute += 5) points.push({ minute, ...sunAt(app.day + (minute + app.offset) * 60000, lat_deg, lon_deg) });
    return points;
  }

  function draw() {
    const css = getComputedStyle(document.documentElement);
    const colour = (name) => css.getPropertyValue(name).trim();
    const ratio = Math.min(3, window.devicePixelRatio || 1);
    size = canvas.clientWidth || 220;
    canvas.width = canvas.height = Math.round(size * ratio);
    const c = canvas.getContext("2d");
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    const m = size / 2, R = radius();
    const day = Math.max(0, Math.min(1, (app.sun.el + 6) / 30));
    const sky = c.createRadialGradient(m, m, 0, m, m, R);
    sky.addColorStop(0, colour(day > 0.25 ? "--sky-high" : "--night-high"));
    sky.addColorStop(1, colour(day > 0.25 ? "--sky-low" : "--night-low"));
    c.fillStyle = sky;
    c.beginPath(); c.arc(m, m, R, 0, 2 * Math.PI); c.fill();
    c.strokeStyle = colour("--ring");
    c.lineWidth = 1;
    for (const el of [30, 60]) { c.beginPath(); c.arc(m, m, (R * (90 - el)) / 90, 0, 2 * Math.PI); c.stroke(); }
    c.beginPath(); c.moveTo(m - R, m); c.lineTo(m + R, m); c.moveTo(m, m - R); c.lineTo(m, m + R); c.stroke();
    c.fillStyle = colour("--faint");
    c.font = "600 11px system-ui, sans-serif";
    c.textAlign = "center"; c.textBaseline = "middle";
    for (const [name, x, y] of [["N", m, m - R - 9], ["S", m, m + R + 10], ["E", m + R + 10, m], ["W", m - R - 10, m]]) c.fillText(name, x, y);

    const way = path();
    c.strokeStyle = colour("--path");
    c.lineWidth = 2;
    c.beginPath();
    let pen = false;
    for (const p of way) {
      if (p.el < 0) { pen = false; continue; }
      const [x, y] = place(p);
      if (pen) c.lineTo(x, y); else c.moveTo(x, y);
      pen = true;
    }
    c.stroke();
    c.fillStyle = colour("--path");
    for (const p of way) {
      if (p.minute % 60 || p.el < 0 || p.minute === 1440) continue;
      const [x, y] = place(p);
      c.beginPath(); c.arc(x, y, 2.4, 0, 2 * Math.PI); c.fill();
    }
    for (const date of app.scene.dates) {
      const [x, y] = place({ az: date.azimuth_deg, el: date.elevation_deg });
      c.strokeStyle = colour("--text");
      c.lineWidth = 1.2;
      c.beginPath(); c.arc(x, y, 3.5, 0, 2 * Math.PI); c.stroke();
    }
    const shown = { az: app.sun.az, el: Math.max(-9, app.sun.el) };
    const [x, y] = place(shown);
    const up = app.sun.el > 0;
    if (up) {
      const glow = c.createRadialGradient(x, y, 2, x, y, 26);
      glow.addColorStop(0, "rgba(255,205,80,.75)");
      glow.addColorStop(1, "rgba(255,205,80,0)");
      c.fillStyle = glow;
      c.beginPath(); c.arc(x, y, 26, 0, 2 * Math.PI); c.fill();
    }
    c.fillStyle = up ? "#ffc53d" : colour("--faint");
    c.strokeStyle = up ? "#b36b00" : colour("--ring");
    c.lineWidth = 1.5;
    c.beginPath(); c.arc(x, y, 8, 0, 2 * Math.PI); c.fill(); c.stroke();
  }

  /// The sun where a finger is; on the way of the day where it is near it.
  function take(event) {
    const box = canvas.getBoundingClientRect();
    const x = event.clientX - box.left - size / 2, y = event.clientY - box.top - size / 2;
    let nearest = null, distance = 11;
    for (const p of path()) {
      if (p.el < 0) continue;
      const [px, py] = place(p);
      const d = Math.hypot(px - size / 2 - x, py - size / 2 - y);
      if (d < distance) { distance = d; nearest = p; }
    }
    if (nearest) return app.setTime(app.day + (nearest.minute + app.offset) * 60000);
    const el = Math.max(0.5, 90 - (90 * Math.hypot(x, y)) / radius());
    app.setAngles((Math.atan2(x, -y) / RAD + 360) % 360, el);
  }
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    app.stop();
    take(event);
  });
  canvas.addEventListener("pointermove", (event) => { if (canvas.hasPointerCapture(event.pointerId)) take(event); });
  return { draw };
}
