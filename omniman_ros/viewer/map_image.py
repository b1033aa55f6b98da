"""The map of what stands, as an image on the floor."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array

Pixels = NDArray[np.uint8]  #: Image (rows, columns, 4): red, green, blue and opacity, 0 to 255

MOST_PIXELS = 512  #: Largest number of pixels along a side; a larger map is reduced
FREE = (231, 245, 235, 255)  #: Colour of what is free
OCCUPIED = (52, 58, 64, 255)  #: Colour of what is occupied; between the two, a mixture


@dataclass(frozen=True)
class MapImage:
    """An image on the floor."""

    pixels: Pixels  #: The image, its rows along y and its columns along x of the map
    size: tuple[float, float]  #: Lengths along x and y [m]
    middle: tuple[float, float, float]  #: Pose of the middle in `odom` [m, m, rad]


def map_pixels(occupancy: NDArray[np.int8]) -> tuple[Pixels, int]:
    """Return an image of occupancies (rows, columns) [%], and the cells along a pixel's side.

    What is unknown (negative) is transparent. A pixel shows the most occupied of its cells; the
    image is filled up to whole pixels with what is unknown.
    """
    count = max(1, math.ceil(max(occupancy.shape) / MOST_PIXELS))
    rows, columns = (-size % count for size in occupancy.shape)
    padded = np.pad(occupancy, ((0, rows), (0, columns)), constant_values=-1)
    height, width = padded.shape[0] // count, padded.shape[1] // count
    most = padded.reshape(height, count, width, count).max(axis=(1, 3))
    return _COLOURS[np.clip(most, -1, 100)], count


def map_image(pixels: Pixels, pixel_size: float, corner: Array) -> MapImage:
    """Return where an image lies whose first pixel has its outer corner at a pose (3,).

    Args:
        pixel_size: Edge of a pixel [m].
        corner: (3,) pose of the first pixel's outer corner in `odom` [m, m, rad].
    """
    width, height = pixel_size * pixels.shape[1], pixel_size * pixels.shape[0]
    x, y, theta = se2.compose(tuple(corner.tolist()), (0.5 * width, 0.5 * height, 0.0))
    return MapImage(pixels, (width, height), (x, y, theta))


def _colours() -> Pixels:
    """Return the colours (102, 4) by the occupancy, the last one for -1."""
    fraction = np.linspace(0.0, 1.0, 101)[:, None]
    between = (1.0 - fraction) * np.array(FREE) + fraction * np.array(OCCUPIED)
    return np.concatenate((between, np.zeros((1, 4)))).round().astype(np.uint8)


_COLOURS = _colours()
