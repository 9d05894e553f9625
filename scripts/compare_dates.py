"""Surfaces of one place from images of two dates, compared where the images say that nothing changed.

usage: compare_dates.py PRODUCTS_A PRODUCTS_B      (folders that `heliosplat products` wrote)

Both albedos are laid on A's grid; a cell counts as unchanged where their brightness correlates over 15 x 15 cells that both know, from
several thresholds on. Says the median absolute difference of the altitudes there, before and after their median difference is taken
off, and how much of that ground both surfaces know.
"""
import sys
import numpy as np
import rasterio
from rasterio.warp import Resampling, reproject
from scipy.ndimage import uniform_filter

def read(folder, name, like=None):
    with rasterio.open(f"{folder}/{name}") as f:
        bands = f.read().astype(float)
        bands[bands == f.nodata] = np.nan
        if like is None:
            return bands, f.transform, f.crs
        out = np.full((len(bands), *like[0]), np.nan)
        reproject(bands, out, src_transform=f.transform, src_crs=f.crs, dst_transform=like[1], dst_crs=like[2],
                  src_nodata=np.nan, dst_nodata=np.nan, resampling=Resampling.bilinear)
        return out

def ncc(a, b, width=15):
    known = np.isfinite(a) & np.isfinite(b)
    share = uniform_filter(known.astype(float), width)
    mean = lambda v: uniform_filter(np.where(known, v, 0.0), width) / np.maximum(share, 1e-9)
    a, b = a - np.nanmean(a), b - np.nanmean(b)
    ma, mb = mean(a), mean(b)
    c = mean(a * b) - ma * mb
    va, vb = mean(a * a) - ma * ma, mean(b * b) - mb * mb
    return np.where(known & (share > 0.5), c / np.sqrt(np.maximum(va * vb, 1e-12)), np.nan)

a, b = sys.argv[1:3]
za, transform, crs = read(a, "dsm.tif")
like = (za.shape[1:], transform, crs)
zb = read(b, "dsm.tif", like)[0]
aa, ab = read(a, "albedo.tif")[0].mean(0), read(b, "albedo.tif", like).mean(0)
za = za[0]
r = ncc(aa, ab)
common = np.isfinite(r)
for least in (-1.0, 0.4, 0.5, 0.6, 0.7):
    same = r >= least
    known = same & np.isfinite(za) & np.isfinite(zb)
    d = (za - zb)[known]
    print(f"correlation >= {least}: {same.sum() / common.sum():.1%} of the common ground, both known on {known.sum() / same.sum():.1%}; "
          f"median |difference| {np.median(abs(d)):.3f} m raw, {np.median(abs(d - np.median(d))):.3f} m after {np.median(d):+.3f} m")
