// Light, as the model has it: colour = albedo * (shade + sun * visible), per band, by the elevation of the sun. The numbers come from
// `Light` in exhibit.rs; this is the only place of the page that knows how they are used.

/// `{sun, shade}`, three numbers each, at an elevation in degrees: linear between those of the table, constant beyond.
function lightAt(table, elevation) {
  const at = table.elevation_deg;
  let i = 0;
  while (i + 1 < at.length && at[i + 1] <= elevation) i++;
  const j = Math.min(i + 1, at.length - 1);
  const t = j > i ? Math.max(0, Math.min(1, (elevation - at[i]) / (at[j] - at[i]))) : 0;
  const mix = (of) => [0, 1, 2].map((k) => of[i][k] * (1 - t) + of[j][k] * t);
  return { sun: mix(table.sun), shade: mix(table.shade) };
}

/// Table of display bytes for each byte of the albedo's picture and 0 to 64 visible parts of the sun:
/// `table[(band * 65 + visible) * 256 + byte]`.
function relitTable(scene, elevation) {
  const { sun, shade } = lightAt(scene.light, elevation);
  const { black } = scene.albedo;
  const gamma = scene.gamma;
  const table = new Uint8Array(3 * 65 * 256);
  const albedo = Float64Array.from({ length: 256 }, (_, byte) => Math.pow(byte / 255, gamma));
  const display = Uint8Array.from({ length: 4096 }, (_, i) =>
    Math.round(255 * Math.pow(Math.max(0, (i / 4095 - black) / (1 - black)), 1 / gamma)));
  for (let band = 0; band < 3; band++) {
    for (let visible = 0; visible <= 64; visible++) {
      const light = shade[band] + (sun[band] * visible) / 64;
      const start = (band * 65 + visible) * 256;
      for (let byte = 0; byte < 256; byte++) {
        table[start + byte] = display[Math.min(4095, Math.round(4095 * albedo[byte] * light))];
      }
    }
  }
  return table;
}
