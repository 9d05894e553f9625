// The view as a file; the plan with a world file, so that a GIS places it.

function pictureFile(app) {
  const { scene, view, plan } = app;

  app.save = () => {
    const [w, h] = app.size();
    app.dragging = false;
    app.draw();
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
  };
  /// The world file of the plan as it is shown: from the centres of the picture's pixels to the map.
  app.worldFile = () => {
    const [w, h] = app.size();
    const t = scene.transform, perPixel = w / view.width / plan.scale;
    const [x, y] = plan.toCell(0.5 * (w / view.width), 0.5 * (h / view.height), w, h);
    const [mx, my] = app.mapAt([x, y]);
    return [t[1] * perPixel, t[4] * perPixel, t[2] * perPixel, t[5] * perPixel, mx, my].map((v) => v.toFixed(10)).join("\n") + "\n";
  };
  byId("save").onclick = app.save;
}
