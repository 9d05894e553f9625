#!/usr/bin/env python3
"""Makes the picture at the top of README from a scene and the products of a run:

    heliosplat synth satellite --site block --seed 12 --out scene
    heliosplat train scene --out run
    heliosplat products run --sun 250,35
    scripts/overview.py scene run docs/overview.png

Needs numpy, pillow and tifffile. The ground shown is that of the scene's truth.
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


def cut(path, square):
    """The part of a product that lies on a square of the map."""
    values, (west, north, cell) = raster(path)
    left, top, right, bottom = square
    columns = slice(round((left - west) / cell), round((right - west) / cell))
    rows = slice(round((north - top) / cell), round((north - bottom) / cell))
    return values[:, rows, columns]


def display(values, low, high):
    """Values as an image of SIDE pixels each way: red, green and blue, or grey."""
    values = np.clip((values - low) / (high - low), 0, 1) ** (1 / 1.6)
    pixels = np.moveaxis(values, 0, 2) if len(values) >= 3 else np.repeat(values[0][..., None], 3, 2)
    image = Image.fromarray((255 * pixels[..., :3]).astype(np.uint8))
    return image.resize((SIDE, SIDE), Image.LANCZOS)


def stretched(values):
    """The first three bands, half a hundredth clipped at either end."""
    values = values[:3]
    return display(values, np.nanpercentile(values, 0.5), np.nanpercentile(values, 99.5))


def hillshade(altitude):
    """Light from the north-west on altitudes of cells of half a metre, all of them known."""
    down, across = np.gradient(altitude, 0.5)
    light = (1 + across + down) / np.sqrt(3 * (1 + across**2 + down**2))
    return display(light[None], -0.2, 1.0)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("run", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()

    truth, (west, north, cell) = raster(options.scene / "truth" / "dsm.tif")
    height, width = truth.shape[1:]
    square = (west, north, west + width * cell, north - height * cell)
    photo, _ = raster(sorted(options.scene.glob("*.tif"))[0])
    top, left = (photo.shape[1] - height) // 2, (photo.shape[2] - width) // 2
    products = options.run / "products"
    panels = {
        "input image": stretched(photo[:, top : top + height, left : left + width]),
        "surface model": hillshade(cut(products / "dsm.tif", square)[0]),
        "albedo, true ortho": stretched(cut(products / "albedo.tif", square)),
        "another sun": stretched(cut(products / "relit.tif", square)),
        "its shadow mask": display(1 - cut(products / "relit_shadow.tif", square), 0, 1),
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
