#!/usr/bin/env python3
"""Opens the tiles of a run in the real CesiumJS and compares what it shows with our own rendering of the same view.

    npm install --prefix somewhere cesium@1.145
    pip install numpy pillow pyproj rasterio        # and a Chromium: apt-get install chromium
    python3 scripts/check_globe.py RUN --cesium somewhere/node_modules/cesium --out DIR [--sun AZ,EL] [--heliosplat PROGRAM]
    python3 scripts/check_globe.py MOSAIC --picture MOSAIC/relit.tif --sun AZ,EL --cesium ... --out DIR

Writes into DIR: the tiles, our rendering from straight above (`relight`; of a mosaic the file given as `--picture`, which must have the same
sun), and pictures: `ours.png`, `globe.png` (what CesiumJS shows from 20 km above through a narrow lens, which is straight down to some
centimetres), `globe-1.png` and `globe-2.png`, the next two levels of detail from the same place, `oblique.png`, and `surface.png`, the
textured surface under the globe's own light.

Says the distance of the picture's corners, as CesiumJS places them, from where PROJ says that they are; the peak signal-to-noise ratio of the
globe's picture to ours, both as display values; and how far the one is shifted against the other. Coarser levels are compared by the means
of as many pixels as their splats cover. Exit code 1 where a corner is off by more than 0.05 m, the ratio of the finest level is below 25 dB,
the shift is above half a pixel, a level is missing, or the browser's console has an error.

CesiumJS must be 1.144 or newer. The pages and files are served on a loopback address, for nothing but this.
"""

import argparse
import base64
import functools
import http.server
import io
import json
import pathlib
import shutil
import subprocess
import sys
import tempfile
import threading

import numpy as np
import pyproj
import rasterio
from PIL import Image

ABOVE_M = 20000.0
SCREEN_MOST = 768  # pixels along a side of the screen: larger ones take a software renderer minutes
LEVELS = 3  # levels of detail that are looked at, from the finest one
WAIT_S = 1500
ERROR_PX = 16  # what a tile may err by from the side, as viewers do by default
CHROMIUM = ["--headless", "--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader", "--hide-scrollbars",
            # Timers of a page that nobody looks at tick once a second, and after five minutes once a minute.
            "--disable-background-timer-throttling", "--disable-backgrounding-occluded-windows", "--disable-renderer-backgrounding",
            "--force-device-scale-factor=1"]

PAGE = """<!doctype html><meta charset=utf-8><style>html,body,#c{margin:0;width:WIDTHpx;height:HEIGHTpx;overflow:hidden}.cesium-widget,.cesium-widget canvas{width:100%;height:100%}.cesium-widget-credits{display:none}</style>
<div id=c></div><script>window.CESIUM_BASE_URL='/cesium/'</script><script src=/cesium/Cesium.js></script><script>
const job=JOB, post=x=>fetch('/result',{method:'POST',body:JSON.stringify(x)});
window.onerror=m=>post({error:String(m)});
const complaints=[];
for(const kind of ['error','warn']){const say=console[kind]; console[kind]=(...a)=>{complaints.push(kind+': '+a.map(String).join(' ')); say(...a);};}
(async()=>{
  Cesium.Ion.defaultAccessToken='';
  const widget=new Cesium.CesiumWidget('c',{globe:false,baseLayer:false,skyBox:false,skyAtmosphere:false,msaaSamples:1,
    contextOptions:{webgl:{preserveDrawingBuffer:true}},scene3DOnly:true});
  const scene=widget.scene, V=a=>new Cesium.Cartesian3(...a);
  scene.renderError.addEventListener((s,e)=>post({error:String(e)}));
  scene.backgroundColor=Cesium.Color.BLACK; scene.sun=undefined; scene.moon=undefined; scene.fog.enabled=false;
  scene.postProcessStages.fxaa.enabled=false;
  if(job.light) scene.light=new Cesium.DirectionalLight({direction:V(job.light),intensity:2.5});
  const tileset=await Cesium.Cesium3DTileset.fromUrl('/tiles/tileset.json');
  // Hidden until all tiles are there: CesiumJS gathers and sorts splats anew whenever other tiles are selected, thirty frames later, and a
  // software renderer takes seconds for each frame that shows them.
  tileset.preloadWhenHidden=true; tileset.show=false;
  scene.primitives.add(tileset);
  scene.screenSpaceCameraController.enableInputs=false;
  const frustum=new Cesium.PerspectiveFrustum({fov:job.fov,aspectRatio:WIDTH/HEIGHT,near:job.near,far:job.far});
  scene.camera.frustum=frustum;
  // Not setView: it goes by way of angles, which lose half a metre straight below.
  const camera=scene.camera; camera.position=V(job.eye); camera.direction=V(job.direction); camera.up=V(job.up);
  camera.right=Cesium.Cartesian3.cross(camera.direction,camera.up,new Cesium.Cartesian3());
  const corners=job.corners.map(c=>{
    const p=Cesium.Matrix4.multiplyByPoint(tileset.root.computedTransform,V(c),new Cesium.Cartesian3());
    const g=Cesium.Cartographic.fromCartesian(p);
    return [Cesium.Math.toDegrees(g.longitude),Cesium.Math.toDegrees(g.latitude),g.height];
  });
  tileset.maximumScreenSpaceError=job.error_px;
  // Splats of new tiles are gathered and sorted by a worker after the tiles are loaded: until then the picture is that of coarser tiles.
  const sorted=()=>{
    const splats=tileset.gaussianSplatPrimitive;
    return !splats||!(!splats._drawCommand||splats._dirty||splats._needsSnapshotRebuild||splats._pendingSnapshot||splats._pendingSortPromise);
  };
  const levels=()=>{
    const count={};
    for(const tile of tileset._selectedTiles){let level=0; for(let t=tile;t.parent;t=t.parent) level++; count[level]=(count[level]||0)+1;}
    return count;
  };
  // Frame by frame: a renderer in software is slower than the page, and with the usual loop its queue only grows.
  widget.useDefaultRenderLoop=false;
  const pause=ms=>new Promise(done=>setTimeout(done,ms)), begun=performance.now(), waited=()=>(performance.now()-begun)/1000;
  const whole=()=>tileset.show&&tileset.tilesLoaded&&sorted()&&tileset._selectedTiles.length>0;
  let last='',url='',looks=0;
  do {
    widget.resize(); widget.render(); looks++;
    await pause(whole()?400:100);
    if(!tileset.show&&looks>2&&tileset.tilesLoaded&&tileset.statistics.numberOfTilesWithContentReady>0) tileset.show=true;
    last=url; url=whole()?scene.canvas.toDataURL('image/png'):'';
  } while((url===''||url!==last)&&waited()<WAIT);
  post({url:url||scene.canvas.toDataURL('image/png'),corners,looks,seconds:waited(),settled:url!==''&&url===last,complaints,tiles_by_level:levels(),
    tiles:tileset.statistics.numberOfTilesWithContentReady,version:Cesium.VERSION,size:[scene.canvas.width,scene.canvas.height]});
})().catch(e=>post({error:String(e&&e.stack||e)}));
</script>"""


class Server:
    """Serves the page, CesiumJS and one folder of tiles, and takes what the page posts."""

    def __init__(self, cesium):
        self.page, self.tiles, self.result, self.done, self.missing, self.errors = b"", None, None, threading.Event(), [], []
        outer = self

        class Handler(http.server.SimpleHTTPRequestHandler):
            def translate_path(self, path):
                path = path.split("?")[0]
                for prefix, folder in (("/cesium/", cesium), ("/tiles/", outer.tiles)):
                    if path.startswith(prefix) and ".." not in path:
                        return str(folder / path[len(prefix):])
                return "/nowhere"

            def do_GET(self):
                if self.path.split("?")[0] == "/":
                    self.send_response(200)
                    self.send_header("Content-Type", "text/html")
                    self.end_headers()
                    self.wfile.write(outer.page)
                else:
                    super().do_GET()

            def send_error(self, code, *rest, **others):
                if self.path != "/favicon.ico":
                    outer.missing.append(f"{code} {self.path}")
                super().send_error(code, *rest, **others)

            def do_POST(self):
                outer.result = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                self.send_response(204)
                self.end_headers()
                outer.done.set()

            def log_message(self, *_):
                pass

        self.http = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory="/nowhere"))
        threading.Thread(target=self.http.serve_forever, daemon=True).start()

    def show(self, chromium, tiles, size, job):
        """The picture of a view, 0 to 1, and what else the page says."""
        self.tiles, self.result = tiles, None
        self.done.clear()
        page = PAGE.replace("JOB", json.dumps(job)).replace("WIDTH", str(size[0])).replace("HEIGHT", str(size[1]))
        page = page.replace("WAIT", str(WAIT_S - 60))
        self.page = page.encode()
        address = f"http://127.0.0.1:{self.http.server_address[1]}/"
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
            command = [chromium, *CHROMIUM, f"--window-size={size[0]},{size[1] + 200}", f"--user-data-dir={profile}", address]
            browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            try:
                if not self.done.wait(WAIT_S):
                    sys.exit(f"the page said nothing within {WAIT_S} s")
            finally:
                browser.terminate()
                browser.wait()
        if "error" in self.result:
            sys.exit(f"CesiumJS: {self.result['error']}")
        for said in self.result.pop("complaints"):
            print(said)
            self.errors += [said] if said.startswith("error") else []
        picture = Image.open(io.BytesIO(base64.b64decode(self.result.pop("url").split(",")[1]))).convert("RGB")
        return np.asarray(picture) / 255.0, self.result


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stdout + done.stderr)
    return json.loads(done.stdout)


def rotation(lon, lat):
    """Rows: east, north and up at a place, in Earth-centred axes."""
    sl, cl, sp, cp = np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat)
    return np.array([[-sl, cl, 0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])


def errors_by_level(tile):
    """Largest geometric error of each level, from the coarsest one."""
    below = [errors_by_level(child) for child in tile.get("children", [])]
    deepest = max(map(len, below), default=0)
    return [tile["geometricError"]] + [max(e[k] for e in below if k < len(e)) for k in range(deepest)]


def means(values, side):
    """Means of squares of pixels of which all are known."""
    rows, cols = (n // side for n in values.shape[:2])
    return values[: rows * side, : cols * side].reshape(rows, side, cols, side, -1).mean((1, 3))


def sample(picture, x, y):
    """Bilinear, pixel centres at integers."""
    x, y = np.clip(x, 0, picture.shape[1] - 1.001), np.clip(y, 0, picture.shape[0] - 1.001)
    c, r = x.astype(int), y.astype(int)
    fx, fy = (x - c)[..., None], (y - r)[..., None]
    top = picture[r, c] * (1 - fx) + picture[r, c + 1] * fx
    return top * (1 - fy) + (picture[r + 1, c] * (1 - fx) + picture[r + 1, c + 1] * fx) * fy


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("run", type=pathlib.Path)
    arguments.add_argument("--cesium", type=pathlib.Path, required=True)
    arguments.add_argument("--out", type=pathlib.Path, required=True)
    arguments.add_argument("--sun")
    arguments.add_argument("--picture", type=pathlib.Path)
    arguments.add_argument("--heliosplat", default="target/release/heliosplat")
    arguments.add_argument("--chromium", default=shutil.which("chromium") or shutil.which("google-chrome") or "chromium")
    args = arguments.parse_args()
    sun = ["--sun", args.sun] if args.sun else []
    args.out.mkdir(parents=True, exist_ok=True)
    tiles, surface = args.out / "tiles", args.out / "surface"
    said = run(args.heliosplat, "export", args.run, "--tiles", tiles, *sun, "--json")
    run(args.heliosplat, "export", args.run, "--tiles", surface, "--mesh", "--json")
    print("tiles", json.dumps(said["written"][0]))
    said = said["said"]
    azimuth, elevation = said["sun"]["azimuth_deg"], said["sun"]["elevation_deg"]
    image = args.picture or args.out / "ours.tif"
    if not args.picture:
        run(args.heliosplat, "relight", args.run, f"--sun={azimuth},{elevation}", "--out", image, "--json")

    # Our picture, as display values.
    display = said["display"]
    with rasterio.open(image) as file:
        counts = np.stack([file.read(band + 1).astype(float) for band in display["bands"]], -1)
        counts[counts == file.nodata] = np.nan
        transform, crs = file.transform, pyproj.CRS(file.crs.to_wkt())
    linear = np.clip((counts - display["black_counts"]) / (display["white_counts"] - display["black_counts"]), 0, 1)
    ours = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    known = np.isfinite(ours).all(-1)

    # Pixels of the screen for each of ours, along a side; of a large site the middle is compared.
    zoom = max(1, min(4, SCREEN_MOST // max(known.shape)))
    keep = [min(side, SCREEN_MOST // zoom) for side in known.shape]
    row, col = ((side - kept) // 2 for side, kept in zip(known.shape, keep))
    ours, known = (a[row : row + keep[0], col : col + keep[1]] for a in (ours, known))
    transform = transform * transform.translation(col, row)

    # The same view on the globe: where our pixels are, by PROJ.
    origin = said["anchor"]["origin"]
    place = [np.radians(origin["lon_deg"]), np.radians(origin["lat_deg"])]
    turn = rotation(*place)
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    centre = np.array(to_ecef.transform(origin["lon_deg"], origin["lat_deg"], origin["height_m"]))
    to_lonlat = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    rows, cols = np.mgrid[: known.shape[0], : known.shape[1]]

    def enu(col, row):
        x, y = transform * (col + 0.5, row + 0.5)
        lon, lat = to_lonlat.transform(x, y)
        ecef = np.stack(to_ecef.transform(lon, lat, np.full(np.shape(lon), origin["height_m"])), -1)
        return (ecef - centre) @ turn.T

    ground = enu(cols.astype(float), rows.astype(float))
    middle = enu(np.array((known.shape[1] - 1) / 2), np.array((known.shape[0] - 1) / 2))
    right = enu(np.array(1.0), np.array(0.0)) - enu(np.array(0.0), np.array(0.0))
    gsd = np.linalg.norm(right)
    right[2] = 0
    right /= np.linalg.norm(right)
    up = np.array([-right[1], right[0], 0.0])
    height, width = zoom * known.shape[0], zoom * known.shape[1]
    pixel = gsd / zoom
    eye = middle + np.array([0, 0, ABOVE_M])
    lens = max(width, height) * pixel / ABOVE_M
    rims = [enu(np.array(c), np.array(r)) for c in (-0.5, known.shape[1] - 0.5) for r in (-0.5, known.shape[0] - 0.5)]
    corners = [(rim + [0, 0, h]).tolist() for rim in rims for h in (0.0, 25.0)]
    world = lambda v: (np.asarray(v) @ turn).tolist()
    job = {"eye": (np.asarray(world(eye)) + centre).tolist(), "direction": world([0, 0, -1]), "up": world(up),
           "fov": 2 * np.arctan(lens / 2), "near": ABOVE_M / 2, "far": 2 * ABOVE_M, "corners": corners}
    server = Server((args.cesium / "Build/Cesium").resolve())
    errors = errors_by_level(json.loads((tiles / "tileset.json").read_text())["root"])
    pictures, results = [], []
    for finest in range(LEVELS):
        # Between what tiles of this level err by and what those above do: the one is half of the other.
        job["error_px"] = 0.75 * errors[len(errors) - 2 - finest] / pixel
        picture, result = server.show(args.chromium, tiles, (width, height), job)
        print("cesium", json.dumps({k: v for k, v in result.items() if k != "corners"}))
        pictures.append(picture)
        results.append(result)
    picture, result = pictures[0], results[0]

    failed = []
    levels = [max(map(int, result["tiles_by_level"])) for result in results]
    failed += ["levels"] if len(set(levels)) < LEVELS else []
    back = pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lon_0={origin['lon_deg']!r} +lat_0={origin['lat_deg']!r} "
        f"+h_0={origin['height_m']!r} +step +inv +proj=cart +ellps=WGS84")
    worst = 0.0
    for corner, (lon, lat, h) in zip(corners, result["corners"]):
        expected = back.transform(*corner)
        off = np.subtract(to_ecef.transform(lon, lat, h), to_ecef.transform(*expected))
        worst = max(worst, float(np.linalg.norm(off)))
    print(f"corners off by {worst:.6f} m at most")
    failed += ["corners"] if worst > 0.05 else []

    # Pixels of the screen under each of ours, averaged.
    aside = ground - middle
    focal = ABOVE_M / pixel
    depth = ABOVE_M - aside[..., 2]
    x = (width - 1) / 2 + focal * (aside @ right) / depth
    y = (height - 1) / 2 - focal * (aside @ up) / depth
    steps = (np.arange(zoom) - (zoom - 1) / 2)

    def globe(dx, dy, picture=picture):
        parts = [sample(picture, x + dx + a, y + dy + b) for a in steps for b in steps]
        return np.mean(parts, 0)

    inner = known.copy()
    inner[:2], inner[-2:], inner[:, :2], inner[:, -2:] = False, False, False, False
    error = lambda dx, dy: float(np.mean((globe(dx, dy) - ours)[inner] ** 2))
    here = error(0, 0)
    psnr = -10 * np.log10(here)
    vertex = lambda a, b: 0.5 * (a - b) / (a - 2 * here + b)
    shift = [vertex(error(-zoom / 2, 0), error(zoom / 2, 0)) * gsd / 2, vertex(error(0, -zoom / 2), error(0, zoom / 2)) * gsd / 2]
    print(f"psnr {psnr:.2f} dB over {int(inner.sum())} pixels of {gsd:.2f} m; shifted by {shift[0]:.3f} m, {-shift[1]:.3f} m (right, up)")
    for level, (picture, side) in enumerate(zip(pictures[1:], (2, 4)), 1):
        difference = globe(0, 0, picture) - ours
        difference[~inner] = np.nan
        ratio = -10 * np.log10(np.nanmean(means(difference, side) ** 2))
        print(f"{level} level(s) above the finest: psnr {ratio:.2f} dB, means of {side} x {side} pixels")
    failed += ["psnr"] if psnr < 25 else []
    failed += ["shift"] if max(map(abs, shift)) > gsd / 2 else []
    save = lambda name, values: Image.fromarray((np.nan_to_num(np.clip(values, 0, 1)) * 255).round().astype(np.uint8)).save(args.out / name)
    save("ours.png", np.kron(np.nan_to_num(ours), np.ones((zoom, zoom, 1))))
    for name, picture in zip(("globe", "globe-1", "globe-2"), pictures):
        save(f"{name}.png", picture)

    # From the side, to look at: the splats, and the surface in the globe's own light.
    extent = max(known.shape) * gsd
    away = np.array([0.55, -0.7, 0.6])
    away /= np.linalg.norm(away)
    side = {**job, "eye": (np.asarray(world(middle + 1.5 * extent * away)) + centre).tolist(), "direction": world(-away),
            "up": world([0, 0, 1] - away[2] * away), "fov": np.radians(40), "near": 1.0, "far": 10 * extent, "error_px": ERROR_PX}
    picture, result = server.show(args.chromium, tiles, (960, 720), side)
    print("from the side", json.dumps(result["tiles_by_level"]))
    save("oblique.png", picture)
    a, e = np.radians(azimuth), np.radians(elevation)
    side["light"] = world([-np.cos(e) * np.sin(a), -np.cos(e) * np.cos(a), -np.sin(e)])
    save("surface.png", server.show(args.chromium, surface, (960, 720), side)[0])
    print(*server.missing, sep="\n", end="")
    failed += ["console"] if server.errors or server.missing else []
    print("failed: " + ", ".join(failed) if failed else "ok")
    return 1 if failed else 0


sys.exit(main())
