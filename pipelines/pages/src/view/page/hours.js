// Hours of sun of every cell on a day: a sweep each quarter of an hour, in turns, so that the page stays awake.

const QUARTER = 15 * 60000;

/// Hours of sun of the 24 hours from `start`; `tell` hears the share that is done, and stops it by returning false.
async function sunHours(app, start, tell) {
  const { lat_deg, lon_deg } = app.scene.place;
  const cells = app.field.z.length;
  const hours = new Float32Array(cells), visible = new Uint8Array(cells);
  let most = 0, awake = performance.now();
  for (let quarter = 0; quarter < 96; quarter++) {
    // The middle of each quarter stands for it.
    const sun = sunAt(start + (quarter + 0.5) * QUARTER, lat_deg, lon_deg);
    if (sun.el <= 0) continue;
    most += 0.25;
    app.sweep(sun.az, sun.el, visible);
    for (let i = 0; i < cells; i++) hours[i] += visible[i] / 256;
    if (performance.now() - awake > 40) {
      await new Promise((resolve) => setTimeout(resolve));
      awake = performance.now();
      if (tell && tell(quarter / 96) === false) return null;
    }
  }
  return { width: app.field.width, height: app.field.height, hours, most };
}
