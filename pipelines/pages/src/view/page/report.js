// What programs ask: `window.heliosplat`, and the report of `#...&report`.

/// The mask of a sun: 1 in shadow, 0 in the sun and where nothing is known; row 0 is the first of the grid, north.
function shadowMask(app, azimuth, elevation) {
  const { width, height, z } = app.field;
  // Unknown cells see the whole sun.
  const mask = app.sweep(azimuth, elevation, new Uint8Array(z.length));
  for (let i = 0; i < mask.length; i++) mask[i] = mask[i] < 32 ? 1 : 0;
  return { width, height, mask };
}

/// Map coordinates of the outer edges: west, south, east, north.
function boundsOf(scene) {
  const [x0, xc, xr, y0, yc, yr] = scene.transform;
  const xs = [], ys = [];
  for (const c of [0, scene.width]) for (const r of [0, scene.height]) { xs.push(x0 + xc * c + xr * r); ys.push(y0 + yc * c + yr * r); }
  return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
}

function writeReport(app) {
  const { scene, field } = app;
  const out = new Uint8Array(field.z.length);
  const suns = 8;
  app.sweep(10, 30, out);
  app.sweep(100, 30, out);
  const began = performance.now();
  for (let k = 0; k < suns; k++) app.sweep(22.5 + 45 * k, 35, out);
  const ms = (performance.now() - began) / suns;
  let both = 0, either = 0;
  for (const date of scene.dates) if (date.agreement) { both += date.agreement.both; either += date.agreement.either; }
  document.getElementById("report").textContent = JSON.stringify({
    width: scene.width,
    height: scene.height,
    bounds: boundsOf(scene),
    crs: scene.crs,
    shadow_share: app.shadowShare(),
    iou_traced: either ? both / either : null,
    ms_per_sun: ms,
    ms_to_first_sun: app.ready,
    sun: { azimuth_deg: app.sun.az, elevation_deg: app.sun.el },
    dates: scene.dates.map((date) => ({ date: date.name, iou: date.agreement ? date.agreement.iou : null })),
  });
}
