"""Pictures of floor, bodies and captions.

Importing this module raises ImportError where Pillow is not installed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFilter, ImageFont

from omniman_ros.core.arrays import Array
from omniman_ros.recording.film.bodies import Triangles
from omniman_ros.recording.film.camera import NEAREST, Camera
from omniman_ros.recording.film.rasterizer import Rasterizer
from omniman_ros.surroundings.occupancy import OccupancyMap
from omniman_ros.viewer.style import Colour, rgb

SAMPLES = 2  #: Pixels along each side that are drawn for one of the film
FLOOR = rgb("#f6f7f9")
GRID = rgb("#e3e7eb")
SHADOW = 0.72  #: Fraction of the light that reaches the floor in a shadow
SHADOW_BLUR = 2.0  #: Radius of the blur of a shadow's edge [drawn px]
#: Direction towards the light, in `odom`
LIGHT = np.array([0.25, 0.45, 0.86]) / math.hypot(0.25, 0.45, 0.86)
AMBIENT, DIFFUSE = 0.58, 0.52
"""Shares of light from all around, and from the light's direction."""
#: Colour of dots
DOT = rgb("#e03131")
DOT_RADIUS = 1.3  #: Radius of dots [px of the film]
#: Colour of occupied cells of a map, opaque; others are transparent
OCCUPIED = (*rgb("#8a94a0"), 255)
OCCUPANCY = 50  #: Occupancy from which a cell is drawn [%]
OPACITY = 0.62  #: Opacity of the bodies around the robot, through which it is seen
PANEL = 0.78  #: Opacity of the panel behind the title
GRID_CELL = 1.0  #: Distance of the lines of the floor's grid [m]
#: Number of lines of the grid on either side of the point that the camera looks at
GRID_EXTENT = 30
INK, QUIET = rgb("#1f2933"), rgb("#5f6b7a")


@dataclass(frozen=True)
class FloorLine:
    """A line on the floor."""

    points: Array  #: (k, 2) points in `odom` [m]
    colour: Colour  #: Colour of the line
    width: float  #: Width [px of the film]


@dataclass(frozen=True)
class Caption:
    """What is written into a picture; title and subtitle are at the upper left."""

    title: str
    subtitle: str
    corner: str  #: Text at the upper right
    alarm: str = ""  #: Text of a banner, which is empty if there is none
    fraction: float = 0.0  #: Fraction of the film that has been shown, 0 to 1


def floor_picture(camera: Camera, occupancy: OccupancyMap | None) -> Any:
    """Return the floor with its grid and a map, as an image of Pillow."""
    camera = _drawn(camera)
    image = Image.new("RGB", camera.size, FLOOR)
    if occupancy is not None:
        _draw_map(image, camera, occupancy)
    draw = ImageDraw.Draw(image)
    middle = np.round(camera.target[:2] / GRID_CELL)
    for k in range(-GRID_EXTENT, GRID_EXTENT + 1):
        for axis in (0, 1):
            along = np.linspace(-GRID_EXTENT, GRID_EXTENT, 2 * GRID_EXTENT + 1)
            points = np.tile(middle, (len(along), 1))
            points[:, axis] += k
            points[:, 1 - axis] += along
            _draw_line(draw, camera, FloorLine(points * GRID_CELL, GRID, 1.0))
    return image


def drawn_frame(
    camera: Camera,
    floor: Any,
    lines: Sequence[FloorLine],
    dots: Array,
    robot: Triangles,
    others: Triangles,
    signs: Triangles,
) -> Any:
    """Return a frame without captions, as an image of Pillow.

    Args:
        floor: Image of `floor_picture`, which is not changed.
        lines: Lines on the floor, from the lowest to the topmost.
        dots: (k, 3) points in `odom` that are drawn as dots [m].
        others: Bodies around it, which throw shadows and are translucent.
        signs: What throws no shadow, and has its own colour from all sides.
    """
    size = camera.size
    camera = _drawn(camera)
    image = floor.copy()
    draw = ImageDraw.Draw(image)
    for line in lines:
        _draw_line(draw, camera, line)
    image = _with_shadows(image, camera, np.concatenate((robot.corners, others.corners)))
    _draw_dots(image, camera, dots)
    raster = Rasterizer(np.asarray(image))
    _rasterize(raster, camera, robot.corners, shaded(robot))
    _rasterize(raster, camera, signs.corners, signs.colours)
    behind = Image.fromarray(raster.image)
    _rasterize(raster, camera, others.corners, shaded(others))
    blended = Image.blend(behind, Image.fromarray(raster.image), OPACITY)
    return blended.resize(size, Image.Resampling.BOX)


def _rasterize(raster: Rasterizer, camera: Camera, corners: Array, colours: Array) -> None:
    """Draw the triangles (t, 3, 3) [m] whose outside is seen, in colours (t, 3) of 0 to 255."""
    places, depth = camera.project(corners)
    outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces = ((corners[:, 0] - camera.position) * outwards).sum(axis=1) < 0.0
    seen = faces & (depth > NEAREST).all(axis=1)
    raster.draw(places[seen], 1.0 / depth[seen], colours[seen].round().astype(np.uint8))


def _draw_dots(image: Any, camera: Camera, dots: Array) -> None:
    draw = ImageDraw.Draw(image)
    places, depth = camera.project(dots)
    radius = DOT_RADIUS * SAMPLES
    for x, y in places[depth > NEAREST].tolist():
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=DOT)


def shaded(triangles: Triangles) -> Array:
    """Return the colours (t, 3) of triangles in the light, 0 to 255."""
    corners = triangles.corners
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.maximum(np.linalg.norm(normals, axis=1), 1e-15)
    towards = np.maximum(normals @ LIGHT / length, 0.0)
    return np.asarray(np.clip(triangles.colours * (AMBIENT + DIFFUSE * towards)[:, None], 0, 255))


class CaptionWriter:
    """Writes captions into pictures of one width and height [px]."""

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = size
        unit = size[1] / 450.0
        self._title = ImageFont.load_default(24.0 * unit)
        self._text = ImageFont.load_default(15.0 * unit)
        self._unit = unit

    def write(self, image: Any, caption: Caption) -> None:
        """Write a caption into an image of Pillow."""
        draw, unit = ImageDraw.Draw(image), self._unit
        width, height = self._size
        boxes = [
            draw.textbbox((18 * unit, 12 * unit), caption.title, self._title),
            draw.textbbox((19 * unit, 43 * unit), caption.subtitle, self._text),
        ]
        edge = 8 * unit
        right = max(box[2] for box in boxes) + edge
        self._dim(image, (boxes[0][0] - edge, boxes[0][1] - edge, right, boxes[1][3] + edge))
        if caption.corner:
            left, top, right, low = draw.textbbox(
                (width - 18 * unit, 16 * unit), caption.corner, self._text, anchor="ra"
            )
            self._dim(image, (left - edge, top - edge, right + edge, low + edge))
        draw.text((18 * unit, 12 * unit), caption.title, INK, self._title)
        draw.text((19 * unit, 43 * unit), caption.subtitle, QUIET, self._text)
        draw.text((width - 18 * unit, 16 * unit), caption.corner, QUIET, self._text, anchor="ra")
        if caption.alarm:
            high = height - 44 * unit
            draw.rectangle((0, high, width, height - 4 * unit), fill=rgb("#c92a2a"))
            draw.text(
                (0.5 * width, high + 20 * unit), caption.alarm, "white", self._text, anchor="mm"
            )
        draw.rectangle((0, height - 4 * unit, width, height), fill=rgb("#dde2e7"))
        draw.rectangle(
            (0, height - 4 * unit, caption.fraction * width, height), fill=rgb("#1971c2")
        )

    @staticmethod
    def _dim(image: Any, box: tuple[float, ...]) -> None:
        left, top, right, low = (round(edge) for edge in box)
        part = image.crop((left, top, right, low))
        plain = Image.new("RGB", part.size, FLOOR)
        image.paste(Image.blend(part, plain, PANEL), (left, top))


def _drawn(camera: Camera) -> Camera:
    size = (SAMPLES * camera.size[0], SAMPLES * camera.size[1])
    return Camera(camera.target, camera.azimuth, camera.elevation, camera.distance, size)


def _draw_line(draw: Any, camera: Camera, line: FloorLine) -> None:
    points = np.column_stack((line.points, np.zeros(len(line.points))))
    places, depth = camera.project(points)
    ahead = (depth > NEAREST) & np.isfinite(places).all(axis=1)
    breaks = np.flatnonzero(~ahead)
    for piece in np.split(np.arange(len(points)), breaks):
        kept = places[piece[ahead[piece]]]
        if len(kept) > 1:
            draw.line(
                [tuple(place) for place in kept.tolist()],
                fill=line.colour,
                width=round(SAMPLES * line.width),
                joint="curve",
            )


def _with_shadows(image: Any, camera: Camera, corners: Array) -> Any:
    # Half of a body's triangles, those in the light, throw all of its shadow.
    outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lit = corners[outwards @ LIGHT > 0.0]
    flat = lit - lit[..., 2:] / LIGHT[2] * LIGHT
    places, depth = camera.project(flat)
    mask = Image.new("L", image.size, 255)
    draw = ImageDraw.Draw(mask)
    shade = round(255 * SHADOW)
    for triangle in places[(depth > NEAREST).all(axis=1)].reshape(-1, 6).tolist():
        draw.polygon(triangle, fill=shade)
    light = mask.filter(ImageFilter.GaussianBlur(SHADOW_BLUR))
    return Image.composite(image, Image.new("RGB", image.size, (0, 0, 0)), light)


def _draw_map(image: Any, camera: Camera, occupancy: OccupancyMap) -> None:
    """Draw a map on the floor.

    A pixel of the image sees the floor at the place that the inverse of the projection gives.
    """
    pixels = np.zeros((*occupancy.values.shape, 4), np.uint8)
    pixels[occupancy.values >= OCCUPANCY] = OCCUPIED
    size = occupancy.resolution
    x, y, theta = occupancy.origin.tolist()
    c, s = size * math.cos(theta), size * math.sin(theta)
    in_odom = np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])
    inverse = np.linalg.inv(_floor_projection(camera) @ in_odom)
    inverse /= inverse[2, 2]
    source = Image.fromarray(pixels, "RGBA")
    coefficients = inverse.reshape(-1)[:8].tolist()
    seen = source.transform(
        image.size, Image.Transform.PERSPECTIVE, coefficients, Image.Resampling.NEAREST
    )
    image.paste(seen.convert("RGB"), (0, 0), seen.getchannel("A"))


def _floor_projection(camera: Camera) -> Array:
    """Return the matrix (3, 3) from places on the floor to places in the image, homogeneous."""
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) + camera.target[:2]
    places, _ = camera.project(np.column_stack((points, np.zeros(4))))
    rows = []
    for (x, y), (u, v) in zip(points, places, strict=True):
        rows += [
            [x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y, -u],
            [0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y, -v],
        ]
    return np.asarray(np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3))
