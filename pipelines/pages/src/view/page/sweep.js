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
// Cost: two walks over the grid, and where rays run along its rows a third one, whatever the heights.

/// Share of the disc in 64 steps, by the height of its middle above the horizon, from one radius below to one above.
const DISC = new Uint8Array(129);
for (let i = 0; i < 129; i++) {
  const u = i / 64 - 1;
  DISC[i] = Math.round(64 * (0.5 + (u * Math.sqrt(1 - u * u) + Math.asin(u)) / Math.PI));
}

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

/// Stands for the sum of an unknown cell.
const UNKNOWN = 65535;

/// Averages what cells see across lines, weights 1, 2, 1, from sums along lines of the same weights. In the place of an unknown neighbour and beyond the
/// border the cell itself counts, so that nothing comes from where nothing is known.
function smoothed(sums, along, across, out) {
  for (let n = 0; n < along; n++) {
    const line = n * across, above = n > 0 ? -across : 0, below = n + 1 < along ? across : 0;
    for (let i = line; i < line + across; i++) {
      const own = sums[i], a = sums[i + above], b = sums[i + below];
      // Most cells see what their neighbours see.
      if (a === own && b === own) out[i] = own === UNKNOWN ? 64 : (own + 2) >> 2;
      else if (own === UNKNOWN) out[i] = 64;
      else out[i] = ((a === UNKNOWN ? own : a) + 2 * own + (b === UNKNOWN ? own : b) + 8) >> 4;
    }
  }
  return out;
}

/// Shadow sweep over a field of `{width, height, z}`, metres, NaN where unknown. `east` and `north` are the changes of
/// column and row per metre; `caster` holds the numbers of pipelines/products/src/surface_shadow.rs.
function sweeper(field, east, north, caster) {
  const { sun_radius_rad: radius, steep, edge_cells: edge, lift_m: lift, low_m: low } = caster;
  const { width, height, z } = field;
  const lying = { heights: z, along: height, across: width };
  const sums = new Uint16Array(z.length);
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
      pass(lying, dr, dc, elevation);
      return smoothed(sums, height, width, out);
    }
    if (!upright) {
      upright = { heights: transposed(z, new Float32Array(z.length), width, height), along: width, across: height };
      turned = new Uint8Array(z.length);
    }
    pass(upright, dc, dr, elevation);
    return transposed(smoothed(sums, width, height, turned), out, height, width);
  };

  /// Writes what each cell sees, summed along its line with its neighbours (weights 1, 2, 1), into `sums`.
  function pass({ heights, along, across }, major, minor, elevation) {
    const tan = Math.tan(elevation * RAD);
    // Metres per line, what the shadow falls over them, and how far a ray moves aside, away from the sun.
    const step = 1 / Math.abs(major), drop = step * tan;
    const aside = -minor / Math.abs(major);
    // Height that the sun's radius spans per line between a cell and what shades it.
    const cosine = Math.cos(elevation * RAD);
    const blur = step * radius / (cosine * cosine);
    const shift = Math.abs(aside) * along;
    const rays = Math.ceil(across + shift) + 3;
    // Ray r is at r + base + line * aside.
    const base = aside >= 0 ? -Math.ceil(shift) - 1 : -1;
    const dark = new Float32Array(rays).fill(-1e9), behind = new Float32Array(rays).fill(1);
    const forward = major < 0;
    const jump = steep * step;
    for (let n = 0; n < along; n++) {
      const line = (forward ? n : along - 1 - n) * across;
      const at = base + n * aside;
      const whole = Math.floor(at), part = at - whole, rest = 1 - part;
      // Ray k lies between the cells k and k + 1, at the share `part`, and cell k between the rays k - 1 and k. So one walk does both: a cell is asked by
      // what its two rays bring from the lines before, then the second of them moves on.
      let a = NaN, darkBefore = 0, blurBefore = 0;
      // What the cells before see, -1 where unknown.
      let left = -1, own = -1;
      for (let k = -1, r = -1 - whole; k < across; k++, r++) {
        const b = k + 1 < across ? heights[line + k + 1] : NaN;
        let darkness = dark[r], lines = behind[r];
        const blurred = blur * lines;
        let seen = -1;
        if (a === a) {
          // What both rays see counts, not their mean height: the border of a long shadow stays in the middle between them.
          const before = a + lift - darkBefore, after = a + lift - darkness;
          if (before >= blurBefore && after >= blurred) seen = 64;
          else {
            const one = before >= blurBefore ? 64 : before <= -blurBefore ? 0 : DISC[(64 * (before / blurBefore + 1) + 0.5) | 0];
            const two = after >= blurred ? 64 : after <= -blurred ? 0 : DISC[(64 * (after / blurred + 1) + 0.5) | 0];
            seen = (one * part + two * rest + 0.5) | 0;
          }
        }
        if (k > 0) sums[line + k - 1] = own < 0 ? UNKNOWN : (left < 0 ? own : left) + 2 * own + (seen < 0 ? own : seen);
        left = own;
        own = seen;
        darkBefore = darkness;
        blurBefore = blurred;
        const difference = a - b;
        let h = difference > jump || difference < -jump ? (part < 0.5 ? a : b) : a - difference * part;
        // Beside an unknown cell the known one counts.
        if (h !== h) h = a === a ? a : b;
        const clear = h - darkness;
        if (clear >= low || clear >= blurred) {
          darkness = Math.fround(h);
          lines = 0;
        } else if (lines === 1 && darkness + drop - h > jump) {
          // A wall: the edge stands beyond the middle of the cell before.
          darkness = Math.fround(darkness + edge * drop);
          lines -= edge;
        }
        dark[r] = darkness - drop;
        behind[r] = lines + 1;
        a = b;
      }
      sums[line + across - 1] = own < 0 ? UNKNOWN : (left < 0 ? own : left) + 3 * own;
    }
  }
}
