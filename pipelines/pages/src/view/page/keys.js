// Keys.

function keys(app) {
  const { oblique } = app;

  addEventListener("keydown", (event) => {
    if (event.target.closest("input, select, summary") || event.ctrlKey || event.metaKey || event.altKey) return;
    const [w, h] = app.size();
    const step = event.shiftKey ? 60 : 10;
    const nudge = (minutes, az, el) => (app.time === null ? app.setAngles(app.sun.az + az, Math.max(0, app.sun.el + el)) : app.setTime(app.time + minutes * MINUTE));
    const actions = {
      ArrowLeft: () => nudge(-step, -step / 5, 0), ArrowRight: () => nudge(step, step / 5, 0),
      ArrowUp: () => nudge(1440, 0, step / 10), ArrowDown: () => nudge(-1440, 0, -step / 10),
      "+": () => app.current().zoom(1.25, w / 2, h / 2, w, h), "=": () => app.current().zoom(1.25, w / 2, h / 2, w, h),
      "-": () => app.current().zoom(0.8, w / 2, h / 2, w, h), 0: () => { app.current().fitted = true; },
      p: () => app.setMode("plan"), o: () => app.setMode("oblique"), l: () => app.setDrawing(!app.drawing), s: app.save,
      "[": () => oblique.turn(10, 0), "]": () => oblique.turn(-10, 0),
      " ": () => { if (event.target.tagName !== "BUTTON") app.play(); },
      Escape: () => { app.line = null; app.setDrawing(false); },
    };
    const action = actions[event.key] ?? actions[event.key.toLowerCase()];
    if (!action || (event.key === " " && event.target.tagName === "BUTTON")) return;
    event.preventDefault();
    if (event.key.startsWith("Arrow")) app.stop();
    action();
    app.ask();
  });
}
