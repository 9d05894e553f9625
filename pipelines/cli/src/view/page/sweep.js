// Shadows of a height field by one sweep of lines away from the sun.
//
// The grid is sheared so that rays of the sun lie along its major axis: from line to line a ray moves one cell along that axis and less
// than one cell along the other. Every ray carries the height below which it is dark, and how far behind lies what throws that shadow. On
// its way a ray samples the heights linearly between the two cells beside it and is never resampled itself, so shadows do not blur
// with their length. A cell lies between two rays and sees of the sun what they see, interpolated.
//
// The sun is a disc: a cell whose horizon cuts it sees a part of it. Unknown cells throw no shadow and are not asked.
//
// Heights say where an edge stands to about half a cell, and rough roofs shade single cells of themselves. So what a cell sees is averaged with its
// neighbours at last: borders become smoother, and nearer to true ones and to those traced through models (docs/lab/sun-page.md).
// Cost: four passes over the grid, whatever the heights.

/// Radius of the sun's disc, radians.
const SUN_RADIUS = 0.2666 * Math.PI / 180;
/// Share of the disc in 64 steps, by the height of its middle above the horizon, from one radius below to one above.
const DISC = new Uint8Array(129);
for (let i = 0; i < 129; i++) {
  const u = i / 64 - 1;
  DISC[i] = Math.round(64 * (0.5 + (u * Math.sqrt(1 - u * u) + Math.asin(u)) / Math.PI));
}

/// Between cells that differ by more than this slope stands a wall: heights are not interpolated over it.
const STEEP = 1;
/// A wall's upper edge is so many cells (below one) beyond the middle of the last high cell: half of that cell, and what the model's edges reach further.
/// Measured against shadows traced through models (docs/lab/sun-page.md).
const EDGE = 0.75;

/// Cells are asked this far above their height, metres: less than heights err by, and enough that level roofs do not speckle themselves under a low
/// sun. Against true shadows nothing is lost by it (docs/lab/sun-page.md).
const LIFT = 0.05;

/// What rises less than this above a far shadow, and still lies in its half-shade, does not hide what throws that shadow, metres.
const LOW = 1;

/// Rows become columns.
function transposed(from, into, width, height) {
  const block = 32;
  for (let r0 = 0; r0 < height; r0 += block) {
    for (let c0 = 0; c0 < width; c0 += block) {
      const r1 = Math.min(r0 + block, height), c1 = Math.min(c0 + block, width);
      for (let r = r0; r < r1; r++) for (let c = c0; c < c1; c++) into[c * height + r] = from[r * width + c];
    }
  }
  return into;
}

/// Averages what cells see with their neighbours, weights 1, 2, 1 along rows and columns. In the place of an unknown neighbour and beyond the border
/// the cell itself counts, so that nothing comes from where nothing is known.
function smoothed(out, { width, height }, unknown, rows) {
  for (let r = 0; r < height; r++) {
    const line = r * width, last = line + width - 1;
    let left = out[line], own = left;
    for (let i = line; i <= last; i++) {
      const right = i < last ? out[i + 1] : own;
      // Most cells see what their neighbours see.
      if (left === own && right === own) rows[i] = 4 * own;
      else rows[i] = (i > line && !unknown[i - 1] ? left : own) + 2 * own + (i < last && !unknown[i + 1] ? right : own);
      left = own;
      own = right;
    }
  }
  for (let r = 0; r < height; r++) {
    const line = r * width, above = r > 0 ? -width : 0, below = r + 1 < height ? width : 0;
    for (let i = line; i < line + width; i++) {
      const own = rows[i], a = rows[i + above], b = rows[i + below];
      if (a === own && b === own) { if (!unknown[i]) out[i] = (own + 2) >> 2; }
      else if (!unknown[i]) out[i] = ((unknown[i + above] ? own : a) + 2 * own + (unknown[i + below] ? own : b) + 8) >> 4;
    }
  }
  return out;
}

/// What sweeps over a field of `{width, height, z}`, metres, NaN where unknown. `east` and `north` are the changes of column and row per metre.
function sweeper(field, east, north) {
  const { width, height, z } = field;
  const lying = { heights: z, along: height, across: width };
  const unknown = Uint8Array.from(z, (h) => (h !== h ? 1 : 0)), rows = new Uint16Array(z.length);
  let upright = null;
  let turned = null;

  /// Share of the sun that each cell sees, 0 to 64, under a sun in degrees; 64 where unknown. Writes into `out`.
  return function sweep(azimuth, elevation, out) {
    if (elevation <= 0) {
      out.fill(0);
      for (let i = 0; i < z.length; i++) if (z[i] !== z[i]) out[i] = 64;
      return out;
    }
    const sin = Math.sin(azimuth * RAD), cos = Math.cos(azimuth * RAD);
    // Change of column and row per metre on the ground toward the sun.
    const dc = sin * east[0] + cos * north[0], dr = sin * east[1] + cos * north[1];
    if (elevation >= 89.99) return out.fill(64);
    if (Math.abs(dr) >= Math.abs(dc)) {
      pass(lying, dr, dc, elevation, out);
      return smoothed(out, field, unknown, rows);
    }
    if (!upright) {
      upright = { heights: transposed(z, new Float32Array(z.length), width, height), along: width, across: height };
      turned = new Uint8Array(z.length);
    }
    pass(upright, dc, dr, elevation, turned);
    return smoothed(transposed(turned, out, height, width), field, unknown, rows);
  };

  function pass({ heights, along, across }, major, minor, elevation, out) {
    const tan = Math.tan(elevation * RAD);
    // Metres per line, what the shadow falls over them, and how far a ray moves aside, away from the sun.
    const step = 1 / Math.abs(major), drop = step * tan;
    const aside = -minor / Math.abs(major);
    // Height that the sun's radius spans per line between a cell and what shades it.
    const cosine = Math.cos(elevation * RAD);
    const blur = step * SUN_RADIUS / (cosine * cosine);
    const shift = Math.abs(aside) * along;
    const rays = Math.ceil(across + shift) + 3;
    // Ray r is at r + base + line * aside.
    const base = aside >= 0 ? -Math.ceil(shift) - 1 : -1;
    const dark = new Float32Array(rays).fill(-1e9), behind = new Float32Array(rays).fill(1);
    const forward = major < 0;
    const jump = STEEP * step;
    for (let n = 0; n < along; n++) {
      const line = (forward ? n : along - 1 - n) * across;
      const at = base + n * aside;
      const whole = Math.floor(at), part = at - whole, rest = 1 - part;
      // The cells of the line: cell k lies between the rays k - whole - 1 and k - whole.
      const first = -whole - 1;
      for (let k = 0; k < across; k++) {
        const h = heights[line + k];
        if (h !== h) { out[line + k] = 64; continue; }
        // What both rays see counts, not their mean height: the border of a long shadow stays in the middle between them.
        const r = first + k;
        const a = h + LIFT - dark[r], b = h + LIFT - dark[r + 1];
        const ra = blur * behind[r], rb = blur * behind[r + 1];
        const va = a >= ra ? 64 : a <= -ra ? 0 : DISC[(64 * (a / ra + 1) + 0.5) | 0];
        const vb = b >= rb ? 64 : b <= -rb ? 0 : DISC[(64 * (b / rb + 1) + 0.5) | 0];
        out[line + k] = va * part + vb * rest + 0.5;
      }
      // The rays: ray r lies between the cells r + whole and r + whole + 1, at the share `part`.
      const from = Math.max(0, -whole - 1), to = Math.min(rays, across - whole);
      for (let r = from; r < to; r++) {
        const k = r + whole;
        const a = k >= 0 ? heights[line + k] : NaN;
        const b = k + 1 < across ? heights[line + k + 1] : NaN;
        const difference = a - b;
        let h = difference > jump || difference < -jump ? (part < 0.5 ? a : b) : a - difference * part;
        // Beside an unknown cell the known one counts.
        if (h !== h) h = a === a ? a : b;
        const clear = h - dark[r];
        if (clear >= LOW || clear >= blur * behind[r]) { dark[r] = h; behind[r] = 0; }
        else if (behind[r] === 1 && dark[r] + drop - h > jump) {
          // A wall: the edge stands beyond the middle of the cell before.
          dark[r] += EDGE * drop;
          behind[r] -= EDGE;
        }
        dark[r] -= drop;
        behind[r] += 1;
      }
    }
  }
}
