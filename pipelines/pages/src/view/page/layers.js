// What can be shown: each layer paints the cells into an RGBA picture, and says what a cell's value is.

/// The pixels of a picture that is loaded.
function readPicture(image, width, height) {
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  return context.getImageData(0, 0, width, height).data;
}

/// A picture of an address; the document's `load` event waits for those that are begun before.
function pictureOf(address) {
  const image = new Image();
  image.src = address;
  return image;
}

const RAMPS = {
  diverging: [[33, 102, 172], [146, 197, 222], [247, 247, 247], [244, 165, 130], [178, 24, 43]],
  sequential: [[13, 8, 60], [84, 20, 110], [170, 48, 96], [230, 100, 50], [250, 190, 70], [252, 250, 190]],
  heights: [[38, 84, 92], [94, 134, 104], [190, 186, 134], [204, 160, 112], [158, 116, 96], [238, 232, 226]],
  sun: [[24, 32, 72], [58, 66, 128], [138, 92, 138], [214, 120, 96], [246, 178, 84], [255, 240, 170]],
};

/// 256 colours of a ramp, three bytes each.
function rampTable(name) {
  const stops = RAMPS[name];
  const out = new Uint8Array(768);
  for (let i = 0; i < 256; i++) {
    const at = (i / 255) * (stops.length - 1), j = Math.min(stops.length - 2, Math.floor(at)), t = at - j;
    for (let k = 0; k < 3; k++) out[3 * i + k] = Math.round(stops[j][k] * (1 - t) + stops[j + 1][k] * t);
  }
  return out;
}

/// Slopes of the surface: the normal's components, and its level part; unknown neighbours count as level.
function normals(field, cell) {
  const { width, height, z } = field;
  const east = new Float32Array(z.length), south = new Float32Array(z.length);
  for (let i = 0, row = 0; row < height; row++) {
    for (let col = 0; col < width; col++, i++) {
      const h = z[i];
      const at = (j, inside) => (inside && z[j] === z[j] ? z[j] : h);
      east[i] = (at(i + 1, col + 1 < width) - at(i - 1, col > 0)) / (2 * cell);
      south[i] = (at(i + width, row + 1 < height) - at(i - width, row > 0)) / (2 * cell);
    }
  }
  return { east, south };
}

/// The layers of a page. `app` has `scene`, `field`, `visible`, `sun` and later `hours`.
function makeLayers(app) {
  const { scene, field } = app;
  const { width, height, z, known } = field;
  const cells = width * height;
  const layers = [];
  const slopes = normals(field, scene.cell_m);

  const shade = (i, light) => {
    const e = slopes.east[i], s = slopes.south[i];
    return Math.max(0, (light[2] - e * light[0] - s * light[1]) / Math.sqrt(1 + e * e + s * s));
  };
  const northWest = [-0.5, -0.5, Math.SQRT1_2];
  const hill = new Uint8Array(cells);
  for (let i = 0; i < cells; i++) hill[i] = known[i] ? Math.round(255 * shade(i, northWest)) : 0;

  const each = (paint) => (rgba) => {
    for (let i = 0, j = 0; i < cells; i++, j += 4) if (known[i]) paint(i, j, rgba);
  };
  const ramp = (name, byte) => {
    const table = rampTable(name);
    return each((i, j, rgba) => {
      const b = 3 * byte(i);
      const g = 0.35 + (0.65 * hill[i]) / 181;
      rgba[j] = table[b] * g; rgba[j + 1] = table[b + 1] * g; rgba[j + 2] = table[b + 2] * g;
    });
  };

  if (scene.albedo) {
    const albedo = readPicture(app.albedo, width, height);
    layers.push({
      id: "relit", name: "In this light", moves: true,
      paint(rgba) {
        const table = relitTable(scene, app.sun.el);
        const visible = app.visible;
        for (let i = 0, j = 0; i < cells; i++, j += 4) {
          if (!known[i]) continue;
          const at = visible[i] << 8;
          rgba[j] = table[at + albedo[j]];
          rgba[j + 1] = table[16640 + at + albedo[j + 1]];
          rgba[j + 2] = table[33280 + at + albedo[j + 2]];
        }
      },
    });
    layers.push({
      id: "albedo", name: "Albedo, without light",
      paint: each((i, j, rgba) => { rgba[j] = albedo[j]; rgba[j + 1] = albedo[j + 1]; rgba[j + 2] = albedo[j + 2]; }),
    });
  }
  layers.push({
    id: "relief", name: "Relief in this light", moves: true,
    paint(rgba) {
      const { el } = app.sun;
      const flat = Math.cos(el * RAD);
      const light = [flat * app.sunward[0], flat * app.sunward[1], Math.sin(el * RAD)];
      each((i, j) => {
        const direct = el > 0 ? (shade(i, light) * app.visible[i]) / 64 : 0;
        const value = 52 + 0.16 * hill[i] + 190 * direct;
        rgba[j] = value * 1.0; rgba[j + 1] = value * 0.985; rgba[j + 2] = 14 + value * 0.93;
      })(rgba);
    },
  });
  layers.push({
    id: "hillshade", name: "Hillshade, light from the north-west",
    paint: each((i, j, rgba) => { rgba[j] = rgba[j + 1] = rgba[j + 2] = hill[i]; }),
  });

  let low = Infinity, high = -Infinity;
  for (let i = 0; i < cells; i++) if (known[i]) { low = Math.min(low, z[i]); high = Math.max(high, z[i]); }
  app.heights = { low, high };
  layers.push({
    id: "heights", name: "Heights",
    legend: { ramp: "heights", low, high, unit: "m", digits: 0 },
    paint: ramp("heights", (i) => Math.round((255 * (z[i] - low)) / Math.max(high - low, 1e-6))),
  });
  layers.push({
    id: "hours", name: "Hours of sun on this date", needs: "hours",
    legend: { ramp: "sun", low: 0, high: 12, unit: "h", digits: 1 },
    value: (i) => (app.hours ? `${app.hours.hours[i].toFixed(1)} h of sun` : ""),
    paint(rgba) {
      if (!app.hours) return;
      this.legend.high = app.hours.most;
      ramp("sun", (i) => Math.min(255, Math.round((255 * app.hours.hours[i]) / Math.max(app.hours.most, 1e-6))))(rgba);
    },
  });
  if (scene.dates.some((date) => date.traced)) {
    layers.push({
      id: "compare", name: "Shadows: this page and the model", moves: true,
      words: [["#23304a", "both"], ["#d9534a", "this page only"], ["#3d7fe0", "model only"]],
      paint(rgba) {
        const traced = app.date ? app.date.traced : null;
        each((i, j) => {
          const mine = app.visible[i] < 32, its = traced && traced[i];
          const g = 0.72 + (0.28 * hill[i]) / 181;
          const colour = mine && its ? [35, 48, 74] : mine ? (traced ? [217, 83, 74] : [35, 48, 74]) : its ? [61, 127, 224] : [228 * g, 224 * g, 214 * g];
          rgba[j] = colour[0]; rgba[j + 1] = colour[1]; rgba[j + 2] = colour[2];
        })(rgba);
      },
    });
  }
  for (const layer of scene.layers) {
    if (layer.picture) {
      // Only read when it is first asked for.
      const one = { id: layer.id, name: layer.name, pixels: null };
      one.load = async () => {
        if (one.pixels) return;
        const image = pictureOf(layer.picture);
        await image.decode();
        one.pixels = readPicture(image, width, height);
      };
      const shown = readMask(layer.known, cells);
      one.paint = (rgba) => {
        if (!one.pixels) return;
        // Outside of the image, and hidden in it.
        each((i, j) => { for (let k = 0; k < 3; k++) rgba[j + k] = shown[i] ? one.pixels[j + k] : 128; })(rgba);
      };
      layers.push(one);
      continue;
    }
    const bytes = layer.data;
    const [from, to] = layer.range;
    const table = rampTable(layer.ramp);
    layers.push({
      id: layer.id, name: layer.name,
      legend: { ramp: layer.ramp, low: from, high: to, unit: layer.unit, digits: 1 },
      value: (i) => (bytes[i] ? `${(from + ((bytes[i] - 1) / 254) * (to - from)).toFixed(2)} ${layer.unit}` : ""),
      paint: each((i, j, rgba) => {
        if (!bytes[i]) { rgba[j] = rgba[j + 1] = rgba[j + 2] = 96; return; }
        const b = 3 * bytes[i];
        rgba[j] = table[b]; rgba[j + 1] = table[b + 1]; rgba[j + 2] = table[b + 2];
      }),
    });
  }
  return layers;
}

/// Fills what is unknown with stripes, so that nobody takes it for ground.
function paintUnknown(field, rgba, [paper, stripe]) {
  const { width, known } = field;
  for (let i = 0, j = 0; i < known.length; i++, j += 4) {
    rgba[j + 3] = 255;
    if (known[i]) continue;
    const colour = ((i % width) + ((i / width) | 0)) % 9 < 2 ? stripe : paper;
    rgba[j] = colour[0]; rgba[j + 1] = colour[1]; rgba[j + 2] = colour[2];
  }
}
