#!/usr/bin/env python3
"""Makes the picture at the top of README from an image of a scene and the products of a run:

    heliosplat train JAX_068 --preset preview --out run
    heliosplat products run --sun 250,35
    scripts/overview.py JAX_068_004_RGB.tif run/products docs/overview.png

Needs numpy, pillow, tifffile and imagecodecs. Shows a square in the middle of the products, and the middle of the image.
"""

import argparse
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image, ImageDraw, ImageFont

SIDE = 320
MARGIN = 8
TITLE = 40


def raster(path):
    """The bands of a file, first axis, and its western edge, northern edge and cell."""
    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        values = page.asarray().astype(np.float32)
        tags = {tag.name: tag.value for tag in page.tags.values()}
    if values.ndim == 2:
        values = values[None]
    elif values.shape[2] < 16:
        values = np.moveaxis(values, 2, 0)
    if "ModelPixelScaleTag" not in tags:
        return values, None
    tie = tags["ModelTiepointTag"]
    return values, (tie[3], tie[4], tags["ModelPixelScaleTag"][0])


def cut(path, side_m):
    """The part of a product within a square in the middle of the map."""
    values, (_, _, cell) = raster(path)
    return middle(values, round(side_m / cell))


def middle(values, side):
    """The middle `side` pixels each way."""
    top, left = (values.shape[1] - side) // 2, (values.shape[2] - side) // 2
    return values[:, top : top + side, left : left + side]


def display(values, low, high):
    """Values as an image of SIDE pixels each way: red, green and blue, or grey."""
    values = np.clip((values - low) / (high - low), 0, 1) ** (1 / 1.6)
    pixels = np.moveaxis(values, 0, 2) if len(values) >= 3 else np.repeat(values[0][..., None], 3, 2)
    image = Image.fromarray((255 * pixels[..., :3]).astype(np.uint8))
    return image.resize((SIDE, SIDE), Image.LANCZOS)


def stretched(values):
    """The first three bands, half a hundredth clipped at either end."""
    values = np.where(values[:3] > -9000, values[:3], np.nan)
    return display(np.nan_to_num(values), np.nanpercentile(values, 0.5), np.nanpercentile(values, 99.5))


def hillshade(altitude, cell_m):
    """Light from the north-west on altitudes; unknown cells lie at the median."""
    altitude = np.where(altitude > -9000, altitude, np.median(altitude[altitude > -9000]))
    down, across = np.gradient(altitude, cell_m)
    light = (1 + across + down) / np.sqrt(3 * (1 + across**2 + down**2))
    return display(light[None], -0.2, 1.0)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("image", type=Path)
    parser.add_argument("products", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--side", type=float, default=170, help="side of the square, metres")
    options = parser.parse_args()

    dsm = options.products / "dsm.tif"
    dsm = dsm if dsm.is_file() else options.products.parent / "dsm.tif"
    _, (_, _, cell) = raster(dsm)
    photo, _ = raster(options.image)
    product = lambda name: cut(options.products / name, options.side)
    panels = {
        "input image": stretched(middle(photo, round(options.side / cell))),
        "surface model": hillshade(cut(dsm, options.side)[0], cell),
        "albedo, true ortho": stretched(product("albedo.tif")),
        "another sun": stretched(product("relit.tif")),
        "its shadow mask": display(1 - np.minimum(product("relit_shadow.tif"), 1), 0, 1),
    }
    picture = Image.new("RGB", (len(panels) * (SIDE + MARGIN) - MARGIN, TITLE + SIDE), "white")
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(24)
    for place, (title, panel) in enumerate(panels.items()):
        x = place * (SIDE + MARGIN)
        draw.text((x + SIDE / 2, TITLE / 2), title, fill="black", font=font, anchor="mm")
        picture.paste(panel, (x, TITLE))
    picture.convert("P", palette=Image.Palette.ADAPTIVE).save(options.out)


if __name__ == "__main__":
    main()
