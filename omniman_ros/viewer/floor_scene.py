"""What lies on the floor or hangs in space as lines: paths, plans, trails, the workspace."""

import math

import numpy as np
import viser

from omniman_ros.viewer.lines import JUMP, segments
from omniman_ros.viewer.meshes import Array
from omniman_ros.viewer.state import Picture

Colour = tuple[int, int, int]

ACCENT: Colour = (253, 126, 20)
GHOST: Colour = (34, 139, 230)
PATH: Colour = (43, 138, 62)
PLAN: Colour = (214, 36, 159)
PREDICTED: Colour = (214, 160, 120)
ROUTE: Colour = (151, 117, 250)
TOOL: Colour = (12, 133, 153)
TRAIL: Colour = (73, 80, 87)
WORKSPACE: Colour = (134, 142, 150)

LIFT = 0.004
"""Height of the lowest line above the floor; each next one is that much higher [m]."""
DASH = 0.12
"""Length of a dash, and of the gap behind it [m]."""
MOST_DASHES = 500
"""Dashes of a line; those of a longer one are longer."""
UNBOUNDED = 200.0
"""A workspace that is as wide as this in some direction is none [m]."""


class LineOf:
    """A line that is sent again only when it has changed.

    Args:
        api: Where to.
        name: Of the line.
        colour: Of the line.
        width: In pixels.
        layer: Of a line on the floor: those above hide those below.
        jump: Pieces that are longer are left out [m].
        dashed: Whether it is broken into dashes.
    """

    def __init__(
        self, api: viser.SceneApi, name: str, colour: Colour, width: float, layer: int,
        jump: float = math.inf, dashed: bool = False,
    ) -> None:  # fmt: skip
        self._version = 0
        self._height = LIFT * layer
        self._jump = jump
        self._dashed = dashed
        self._handle = api.add_line_segments(
            name, np.zeros((1, 2, 3)), colour, thickness=width, thickness_units="screen",
            visible=False,
        )  # fmt: skip

    def show(self, points: Array, version: int) -> None:
        """Show points (k, 2) on the floor or (k, 3) in space [m]; NaN breaks the line."""
        if version != self._version:
            self._version = version
            self.draw(self._pieces(points))

    def draw(self, pieces: Array) -> None:
        """Show pieces (p, 2, 3) [m]."""
        if len(pieces):
            self._handle.points = pieces.astype(np.float32)
        self._handle.visible = bool(len(pieces))

    def _pieces(self, points: Array) -> Array:
        if points.shape[1] == 3:
            pieces = np.stack([points[:-1], points[1:]], axis=1)
            known: Array = pieces[np.isfinite(pieces).all(axis=(1, 2))]
            return known
        flat = dashes(points) if self._dashed else segments(points, self._jump)
        full = np.full((len(flat), 2, 3), self._height)
        full[:, :, :2] = flat
        return full


def dashes(points: Array, dash: float = DASH, most: int = MOST_DASHES) -> Array:
    """Pieces (p, 2, 2) of a line (k, 2) [m], with gaps as long as they are.

    Args:
        points: Of the line.
        dash: Length of a piece along the line, at least [m].
        most: Pieces; of a longer line they are longer.
    """
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 2:
        return np.zeros((0, 2, 2))
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    count = min(max(math.ceil(0.5 * along[-1] / dash), 1), most)
    # An odd number of steps: the line begins and ends with a dash.
    stops = np.linspace(0.0, along[-1], 2 * count)
    ends = np.stack([np.interp(stops, along, points[:, i]) for i in range(2)], axis=1)
    pieces: Array = ends.reshape(count, 2, 2)
    return pieces


def rectangle(bounds: tuple[float, float, float, float] | None) -> Array:
    """Outline (5, 2) of x_min, y_min, x_max, y_max [m]; (0, 2) where there is none."""
    if bounds is None:
        return np.zeros((0, 2))
    x_min, y_min, x_max, y_max = bounds
    if not (x_max - x_min < UNBOUNDED and y_max - y_min < UNBOUNDED):
        return np.zeros((0, 2))
    return np.array(
        [[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max], [x_min, y_min]]
    )


class FloorScene:
    """Floor and lines.

    Args:
        api: Where to.
        root: The frame that all stands on.
    """

    def __init__(self, api: viser.SceneApi, root: str) -> None:
        api.add_grid(
            f"{root}/floor", infinite_grid=True, cell_size=0.5, section_size=1.0,
            cell_thickness=0.6, section_thickness=1.0, cell_color=(222, 226, 230),
            section_color=(190, 196, 202), fade_distance=40.0, shadow_opacity=0.0,
        )  # fmt: skip
        api.add_frame(f"{root}/odom", axes_length=0.3, axes_radius=0.008, origin_radius=0.012)
        self._workspace = LineOf(api, f"{root}/workspace", WORKSPACE, 2.0, 1)
        self._bounds: tuple[float, float, float, float] | None = None
        self._route = LineOf(api, f"{root}/route", ROUTE, 2.0, 2, dashed=True)
        self._path = LineOf(api, f"{root}/path", PATH, 3.0, 3)
        self._truth_trail = LineOf(api, f"{root}/ghost_trail", GHOST, 2.0, 4, JUMP)
        self._odom_trail = LineOf(api, f"{root}/trail", TRAIL, 2.0, 5, JUMP)
        self._reference = LineOf(api, f"{root}/reference", ACCENT, 4.0, 6)
        self._predicted = LineOf(api, f"{root}/predicted", PREDICTED, 1.5, 7)
        self._plan = LineOf(api, f"{root}/plan", PLAN, 4.0, 8)
        self._tool_path = LineOf(api, f"{root}/tool_path", TOOL, 3.0, 8)

    def draw_motion(self, picture: Picture) -> None:
        """Show what comes next: short lines that move with the robot."""
        for line, what in ((self._reference, picture.reference), (self._plan, picture.plan)):
            line.show(what.points, what.version)

    def draw(self, picture: Picture) -> None:
        """Show what lies still, or is long."""
        for line, what in (
            (self._route, picture.route),
            (self._path, picture.path),
            (self._truth_trail, picture.truth_trail),
            (self._odom_trail, picture.odom_trail),
            (self._predicted, picture.predicted),
            (self._tool_path, picture.tool_path),
        ):
            line.show(what.points, what.version)
        if picture.workspace != self._bounds:
            self._bounds = picture.workspace
            corners = rectangle(picture.workspace)
            flat = np.column_stack([corners, np.full(len(corners), LIFT)])
            self._workspace.draw(np.stack([flat[:-1], flat[1:]], axis=1))
