"""Walls of photographs for the simulated experiments."""

import cv2
import numpy

TILE_PX = (1000, 800)


def compose(paths, columns, output, seed, mirrored=False):
    """Writes the photographs, row by row and each stretched over a tile of TILE_PX, as one image. Those that are absent
    give way to rectangles of random size and grey. With `mirrored`, the mirrored photographs follow, in reverse order.
    Returns the names of the absent ones."""
    absent, tiles = [], []
    rng = numpy.random.default_rng(seed)
    for path in paths:
        photograph = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if photograph is None:
            absent.append("/".join(path.parts[-2:]))
            tiles.append(rectangles(rng))
        else:
            shrinks = photograph.shape[1] > TILE_PX[0]
            tiles.append(cv2.resize(photograph, TILE_PX, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC))
    if mirrored:
        tiles += [cv2.flip(tile, 1) for tile in reversed(tiles)]
    rows = [numpy.hstack(tiles[i:i + columns]) for i in range(0, len(tiles), columns)]
    if not cv2.imwrite(str(output), numpy.vstack(rows)):
        raise OSError(f"{output}: cannot be written")
    return absent


def rectangles(rng):
    """A tile of overlapping rectangles from large to small."""
    tile = numpy.full(TILE_PX[::-1], 128, numpy.uint8)
    for size in numpy.geomspace(300, 6, 4000):
        x, y = rng.integers(-20, TILE_PX[0]), rng.integers(-20, TILE_PX[1])
        width, height = (size * rng.uniform(0.4, 1.6, 2)).astype(int) + 2
        cv2.rectangle(tile, (int(x), int(y)), (int(x + width), int(y + height)), int(rng.integers(10, 245)), -1)
    return tile


def plane(texture, tiles, tile_m, distance_m):
    """Plane of a scene with the composed texture, `tiles` (columns, rows) of `tile_m`, facing a camera at the origin."""
    return {"texture": str(texture), "size": [tiles[0] * tile_m[0], tiles[1] * tile_m[1]],
            "position": [0.0, 0.0, distance_m]}
