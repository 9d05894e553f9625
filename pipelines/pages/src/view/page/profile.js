// Heights along a line: a chart in metres, dark where the line lies in shadow.

function profileChart(app) {
  const box = document.getElementById("profile"), canvas = document.getElementById("profile-chart");
  const said = document.getElementById("profile-said");
  document.getElementById("profile-close").onclick = () => { app.line = null; box.hidden = true; app.redraw(); };

  return function draw() {
    box.hidden = !app.line || app.line.length < 2;
    if (box.hidden) return;
    const { width, height, z, known } = app.field;
    const [[x0, y0], [x1, y1]] = app.line;
    const cells = Math.hypot(x1 - x0, y1 - y0);
    const n = Math.max(2, Math.min(2000, Math.ceil(cells * 2)));
    const metres = cells * app.scene.cell_m;
    const points = [];
    let low = Infinity, high = -Infinity;
    for (let k = 0; k <= n; k++) {
      const x = Math.floor(x0 + ((x1 - x0) * k) / n), y = Math.floor(y0 + ((y1 - y0) * k) / n);
      const i = x >= 0 && y >= 0 && x < width && y < height ? y * width + x : -1;
      const h = i >= 0 && known[i] ? z[i] : NaN;
      points.push({ at: (metres * k) / n, h, dark: i >= 0 && app.visible[i] < 32 });
      if (h === h) { low = Math.min(low, h); high = Math.max(high, h); }
    }
    if (!(high >= low)) { said.textContent = "Nothing is known along this line."; return; }
    const ratio = Math.min(3, window.devicePixelRatio || 1);
    const w = canvas.clientWidth, h = canvas.clientHeight;
    canvas.width = w * ratio; canvas.height = h * ratio;
    const c = canvas.getContext("2d");
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    const css = getComputedStyle(document.documentElement);
    const text = css.getPropertyValue("--faint"), line = css.getPropertyValue("--text");
    const left = 40, bottom = 18, top = 8, right = 10;
    const span = Math.max(high - low, 1);
    const X = (m) => left + ((w - left - right) * m) / Math.max(metres, 1e-6);
    const Y = (v) => top + (h - top - bottom) * (1 - (v - low) / span);
    for (let k = 0; k < n; k++) {
      const a = points[k], b = points[k + 1];
      if (a.h !== a.h || b.h !== b.h) continue;
      c.fillStyle = b.dark ? "rgba(40,60,110,.45)" : "rgba(255,190,60,.42)";
      c.beginPath();
      c.moveTo(X(a.at), h - bottom); c.lineTo(X(a.at), Y(a.h)); c.lineTo(X(b.at) + 0.4, Y(b.h)); c.lineTo(X(b.at) + 0.4, h - bottom);
      c.fill();
    }
    c.strokeStyle = line;
    c.lineWidth = 1.4;
    c.beginPath();
    let pen = false;
    for (const p of points) {
      if (p.h !== p.h) { pen = false; continue; }
      if (pen) c.lineTo(X(p.at), Y(p.h)); else c.moveTo(X(p.at), Y(p.h));
      pen = true;
    }
    c.stroke();
    c.fillStyle = text;
    c.font = "11px system-ui, sans-serif";
    c.textBaseline = "middle"; c.textAlign = "right";
    c.fillText(high.toFixed(1), left - 5, Y(high)); c.fillText(low.toFixed(1), left - 5, Y(low));
    c.textBaseline = "bottom"; c.textAlign = "left";
    c.fillText("0 m", left, h - 2);
    c.textAlign = "right";
    c.fillText(`${metres.toFixed(1)} m`, w - right, h - 2);
    const first = points.find((p) => p.h === p.h), lastOne = points.findLast((p) => p.h === p.h);
    const rise = lastOne.h - first.h;
    said.textContent = `${metres.toFixed(1)} m long, from ${first.h.toFixed(1)} to ${lastOne.h.toFixed(1)} m (${rise >= 0 ? "+" : "−"}${Math.abs(rise).toFixed(1)} m), highest ${high.toFixed(1)} m`;
  };
}
