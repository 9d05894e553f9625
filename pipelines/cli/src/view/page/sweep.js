// Shadows of a height field by one sweep of lines away from the sun.
//
// The grid is sheared so that rays of the sun lie along its major axis: from line to line a ray moves one cell along that axis and less
// than one cell along the other. Every ray carries the height below which it is dark, and how far behind lies what throws that shadow. On
// its way a ray samples the heights linearly between the two cells beside it and is never resampled itself, so shadows do not blur
// with their length. A cell lies between two rays and sees of the sun what they see, interpolated.
//
// The sun is a disc: a cell whose horizon cuts it sees a part of it. Unknown cells throw no shadow and are not asked.
// Cost: two passes over the grid, whatever the heights.

/// Radius of the sun's disc, radians.
const SUN_RADIUS = 0.2666 * Math.PI / 180;
/// Share of the disc in 64 steps, by the height of its middle above the horizon, from one radius below to one above.
const DISC = new Uint8Array(129);
for (let i = 0; i < 129; i++) {
  const u = i / 64 - 1;
  DISC[i] = Math.round(64 * (0.5 + (u * Math.sqrt(1 - u * u) + Math.asin(u)) / Math.PI));
}

/// Between cells that differ by more than this slope stands a wall: heights are not interpolated over it.
const STEEP = 1.5;
/// A wall's upper edge is so many cells (below one) beyond the middle of the last high cell: half of that cell, and what the model's edges reach further.
/// Measured against shadows traced through models (docs/lab/sun-page.md).
const EDGE = 0.75;

/// Cells are asked this far above their height, metres: less than heights err by, and enough that level roofs do not speckle themselves under a low
/// sun. Against true shadows nothing is lost by it (docs/lab/sun-page.md).
const LIFT = 0.1;

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

/// What sweeps over a field of `{width, height, z}`, metres, NaN where unknown. `east` and `north` are the changes of column and row per metre.
function sweeper(field, east, north) {
  const { width, height, z } = field;
  const lying = { heights: z, along: height, across: width };
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
      return out;
    }
    if (!upright) {
      upright = { heights: transposed(z, new Float32Array(z.length), width, height), along: width, across: height };
      turned = new Uint8Array(z.length);
    }
    pass(upright, dc, dr, elevation, turned);
    return transposed(turned, out, height, width);
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
