// Pointers: where they are on the surface, and what they move.

function pointing(app) {
  const { scene, field, view, stage, plan, oblique, front } = app;
  const { known, width, height } = field;

  // Where a pixel is.
  app.cellAt = (px, py) => {
    const [w, h] = app.size();
    if (app.mode === "plan") return plan.toCell(px, py, w, h);
    const i = oblique.cellAt(px, py, w);
    return i < 0 ? null : [(i % width) + 0.5, Math.floor(i / width) + 0.5];
  };
  app.mapAt = ([x, y]) => {
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
    const [mx, my] = app.mapAt(cell), [lon, lat] = lonLatAt(cell);
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
    app.dragging = true;
    readOut(app.cellAt(...spot(event)));
    if (app.drawing && pointers.size === 1) {
      const cell = app.cellAt(...spot(event));
      if (cell) { app.line = [cell, cell]; line = true; }
    }
  });
  view.addEventListener("pointermove", (event) => {
    const now = spot(event);
    if (!pointers.has(event.pointerId)) return readOut(app.cellAt(...now));
    const before = pointers.get(event.pointerId);
    pointers.set(event.pointerId, now);
    if (line && pointers.size === 1) {
      const cell = app.cellAt(...now);
      if (cell) app.line = [app.line[0], cell];
      readOut(cell);
      return app.ask();
    }
    if (pointers.size === 1) {
      if (turning && app.mode === "oblique") { oblique.turn((now[0] - before[0]) * 0.4, (now[1] - before[1]) * 0.3); if (oblique.fitted) app.fit(); }
      else app.current().move(now[0] - before[0], now[1] - before[1]);
    } else {
      const [a, b] = [...pointers.values()];
      const next = { length: Math.hypot(a[0] - b[0], a[1] - b[1]), angle: Math.atan2(b[1] - a[1], b[0] - a[0]), x: (a[0] + b[0]) / 2, y: (a[1] + b[1]) / 2 };
      if (pinch) {
        app.current().zoom(next.length / pinch.length, next.x, next.y, ...app.size());
        app.current().move(next.x - pinch.x, next.y - pinch.y);
        if (app.mode === "oblique") oblique.turn((next.angle - pinch.angle) / RAD, 0);
      }
      pinch = next;
    }
    app.ask();
  });
  const release = (event) => {
    pointers.delete(event.pointerId);
    pinch = null;
    if (line) { line = false; app.setDrawing(false); }
    app.dragging = pointers.size > 0;
    app.ask();
  };
  view.addEventListener("pointerup", release);
  view.addEventListener("pointercancel", release);
  view.addEventListener("wheel", (event) => {
    event.preventDefault();
    app.current().zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0016)), ...spot(event), ...app.size());
    app.ask();
  }, { passive: false });
  const divider = byId("divider");
  divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
  divider.addEventListener("pointermove", (event) => {
    if (!divider.hasPointerCapture(event.pointerId)) return;
    app.split = Math.max(0.02, Math.min(0.98, spot(event)[0] / stage.clientWidth));
    app.ask();
  });
}
