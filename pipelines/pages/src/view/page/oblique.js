// The surface from the side, in parallel projection, drawn column by column from front to back: what rises above all that is drawn before it
// is visible. No graphics card is asked, so every machine draws the same.

/// A view of a field from the side.
function obliqueView(field, cell) {
  const { width, height, z, known } = field;
  // Few cells far below or above the rest do not count.
  const sample = Float32Array.from({ length: Math.min(20000, z.length) }, (_, k) => z[Math.floor((k * z.length) / Math.min(20000, z.length))]).filter((h) => h === h).sort();
  const quantile = (share) => sample[Math.floor(share * (sample.length - 1))] ?? 0;
  const low = quantile(0.01), high = quantile(0.995), middle = quantile(0.5);
  // What is shown stands on a plinth.
  const ground = low - Math.max(1.5, 0.06 * (high - low)) - 3 * cell;
  const view = { heading: 20, pitch: 38, x: width / 2, y: height / 2, scale: 1, fitted: true };
  let buffer = null;

  view.axes = () => {
    const a = view.heading * RAD;
    return { right: [Math.cos(a), Math.sin(a)], ahead: [Math.sin(a), -Math.cos(a)], flat: Math.sin(view.pitch * RAD), tall: Math.cos(view.pitch * RAD) };
  };
  view.toPixel = (x, y, w, h, level) => {
    const { right, ahead, flat, tall } = view.axes();
    const dx = x - view.x, dy = y - view.y, s = view.scale;
    const i = Math.min(height - 1, Math.max(0, y | 0)) * width + Math.min(width - 1, Math.max(0, x | 0));
    const top = level ?? (known[i] ? z[i] : middle);
    return [w / 2 + s * (dx * right[0] + dy * right[1]), h / 2 - s * (flat * (dx * ahead[0] + dy * ahead[1]) + (tall * (top - middle)) / cell)];
  };
  view.fit = (w, h, [left, right, top, bottom]) => {
    view.x = width / 2;
    view.y = height / 2;
    view.scale = 1;
    let box = [Infinity, Infinity, -Infinity, -Infinity];
    for (const x of [0, width]) for (const y of [0, height]) for (const level of [ground, middle + 0.6 * (high - middle)]) {
      const [px, py] = view.toPixel(x, y, 0, 0, level);
      box = [Math.min(box[0], px), Math.min(box[1], py), Math.max(box[2], px), Math.max(box[3], py)];
    }
    view.scale = Math.max(0.02, Math.min((w - left - right) / (box[2] - box[0]), (h - top - bottom) / (box[3] - box[1])));
    const middleX = ((box[0] + box[2]) / 2) * view.scale, middleY = ((box[1] + box[3]) / 2) * view.scale;
    view.move(-middleX + (left - right) / 2, -middleY + (top - bottom) / 2, true);
    view.fitted = true;
  };
  view.move = (dx, dy, free) => {
    const { right, ahead, flat } = view.axes();
    const u = -dx / view.scale, f = dy / view.scale / flat;
    view.x += u * right[0] + f * ahead[0];
    view.y += u * right[1] + f * ahead[1];
    if (!free) {
      view.x = Math.max(0, Math.min(width, view.x));
      view.y = Math.max(0, Math.min(height, view.y));
      view.fitted = false;
    }
  };
  view.turn = (dx, dy) => {
    view.heading = (view.heading - dx + 720) % 360;
    view.pitch = Math.max(12, Math.min(85, view.pitch + dy));
  };
  view.zoom = (factor, px, py, w, h) => {
    const before = view.scale;
    view.scale = Math.max(0.05, Math.min(40, view.scale * factor));
    const gain = view.scale / before - 1;
    view.move(-(px - w / 2) * gain, -(py - h / 2) * gain);
    view.fitted = false;
  };
  /// The cell drawn at a pixel; -1 where there is none.
  view.cellAt = (px, py, w) => {
    if (!buffer) return -1;
    const q = buffer.quality;
    const x = Math.floor(px * q), y = Math.floor(py * q);
    return x >= 0 && y >= 0 && x < buffer.width && y < buffer.height ? buffer.cells[y * buffer.width + x] - 1 : -1;
  };
  /// Draws the colours `first` (RGBA of the cells), right of the column `split` those of `second`; `sunward` is the grid's
  /// direction to the sun, `plinth` the colour of the cut edge.
  view.draw = (context, w, h, first, second, split, sunward, quality, plinth) => {
    const W = Math.round(w * quality), H = Math.round(h * quality);
    if (!buffer || buffer.width !== W || buffer.height !== H) {
      const canvas = document.createElement("canvas");
      canvas.width = W;
      canvas.height = H;
      const brush = canvas.getContext("2d");
      buffer = { canvas, brush, width: W, height: H, image: brush.createImageData(W, H), cells: new Uint32Array(W * H) };
    }
    buffer.quality = quality;
    const pixels = new Uint32Array(buffer.image.data.buffer);
    pixels.fill(0);
    buffer.cells.fill(0);
    const { right, ahead, flat, tall } = view.axes();
    const s = view.scale * quality, rise = (s * tall) / cell;
    const stride = Math.max(0.35, Math.min(1, 1 / (s * flat)));
    const wallLight = 0.52 + 0.4 * Math.max(0, -(sunward[0] * ahead[0] + sunward[1] * ahead[1]));
    const a = new Uint32Array(first.buffer), b = second ? new Uint32Array(second.buffer) : a;
    const edge = plinth.reduce((colour, value, k) => colour | Math.min(255, value * (0.75 + 0.25 * wallLight)) << (8 * k), 0xff000000);
    const shaded = (colour) =>
      0xff000000 | (((colour >> 16) & 255) * wallLight) << 16 | (((colour >> 8) & 255) * wallLight) << 8 | ((colour & 255) * wallLight);
    const reach = Math.hypot(width, height);
    for (let x = 0; x < W; x++) {
      const colours = second && x >= split * quality ? b : a;
      const u = (x + 0.5 - W / 2) / s;
      const x0 = view.x + u * right[0], y0 = view.y + u * right[1];
      // Where the line of sight is over the grid.
      let near = -reach - Math.abs(u), far = reach + Math.abs(u);
      for (const [start, slope, size] of [[x0, ahead[0], width], [y0, ahead[1], height]]) {
        if (Math.abs(slope) < 1e-9) { if (start < 0 || start >= size) far = near; continue; }
        const t0 = -start / slope, t1 = (size - start) / slope;
        near = Math.max(near, Math.min(t0, t1));
        far = Math.min(far, Math.max(t0, t1));
      }
      let top = H, before = ground, last = -1;
      const end = far - 1e-6;
      for (let f = near + 1e-6; f < end; f += stride) {
        const i = ((y0 + f * ahead[1]) | 0) * width + ((x0 + f * ahead[0]) | 0);
        if (!known[i]) { before = ground; last = -1; continue; }
        const h0 = z[i] > ground ? z[i] : ground;
        const foot = H / 2 - s * flat * f;
        const y = Math.max(0, Math.ceil(foot - rise * (h0 - middle)));
        if (y < top) {
          const wall = h0 - before > 1.5 * cell ? foot - rise * (before - middle) : -1;
          const colour = colours[i] | 0xff000000;
          const dark = wall < 0 ? colour : last < 0 ? edge : shaded(colour);
          const crest = wall >= 0 ? y + Math.max(1, s * flat * stride) : H;
          // Below the cut edge is nothing.
          const from = last < 0 ? Math.min(top, Math.ceil(foot - rise * (ground - middle))) : top;
          for (let py = from - 1; py >= y; py--) {
            pixels[py * W + x] = py >= crest ? dark : colour;
            buffer.cells[py * W + x] = i + 1;
          }
          top = y;
        }
        before = h0;
        last = i;
      }
    }
    buffer.brush.putImageData(buffer.image, 0, 0);
    context.imageSmoothingEnabled = true;
    context.drawImage(buffer.canvas, 0, 0, w, h);
  };
  return view;
}
