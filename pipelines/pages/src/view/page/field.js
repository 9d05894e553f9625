// What the page carries, read back: see pack.rs.

/// The bytes of a packed text: base64 of a zlib stream.
async function unpacked(text) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new ReadableStream({ start(to) { to.enqueue(packed); to.close(); } });
  const reader = stream.pipeThrough(new DecompressionStream("deflate")).getReader();
  const parts = [];
  for (let part = await reader.read(); !part.done; part = await reader.read()) parts.push(part.value);
  const out = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  for (let at = 0, i = 0; i < parts.length; at += parts[i++].length) out.set(parts[i], at);
  return out;
}

/// Replaces every packed text of a scene by its bytes; returns the scene.
async function unpack(scene) {
  const places = [[scene.heights, ["data", "known"]], ...scene.dates.map((date) => [date, ["mask"]]), ...scene.layers.map((layer) => [layer, ["data", "known"]])];
  const texts = places.flatMap(([of, keys]) => keys.filter((key) => of[key]).map((key) => [of, key]));
  await Promise.all(texts.map(async ([of, key]) => (of[key] = await unpacked(of[key]))));
  return scene;
}

/// 1 where a bit is set.
function readMask(bytes, cells) {
  const out = new Uint8Array(cells);
  for (let i = 0; i < cells; i++) out[i] = (bytes[i >> 3] >> (7 - (i & 7))) & 1;
  return out;
}

/// Heights in metres, NaN where unknown, and which cells are known.
function readField(scene) {
  const { width, height, heights } = scene;
  const cells = width * height;
  const bytes = heights.data, known = readMask(heights.known, cells);
  const steps = new Uint16Array(cells);
  for (let i = 0, row = 0; row < height; row++) {
    for (let col = 0; col < width; col++, i++) {
      let expected;
      if (row === 0) expected = col === 0 ? 0 : steps[i - 1];
      else if (col === 0) expected = steps[i - width];
      else {
        const left = steps[i - 1], above = steps[i - width], corner = steps[i - width - 1];
        const low = left < above ? left : above, high = left < above ? above : left;
        expected = corner >= high ? low : corner <= low ? high : left + above - corner;
      }
      const folded = bytes[i] | (bytes[cells + i] << 8);
      steps[i] = expected + ((folded >> 1) ^ -(folded & 1));
    }
  }
  const z = new Float32Array(cells);
  for (let i = 0; i < cells; i++) z[i] = known[i] ? heights.low_m + heights.step_m * steps[i] : NaN;
  return { width, height, z, known };
}

/// Intersection over union of two shadows where heights are known; 1 where neither has any.
function agreement(seen, traced, known) {
  let both = 0, either = 0;
  for (let i = 0; i < known.length; i++) {
    if (!known[i]) continue;
    const a = seen[i] < 32 ? 1 : 0, b = traced[i];
    both += a & b;
    either += a | b;
  }
  return { both, either, iou: either ? both / either : 1 };
}
