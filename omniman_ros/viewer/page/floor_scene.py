"""The floor, and the lines on it and in space: paths, plans, trails, the workspace."""

import math

import numpy as np
import viser

from omniman_ros.core.arrays import Array
from omniman_ros.viewer import style
from omniman_ros.viewer.lines import JUMP, segments
from omniman_ros.viewer.style import Colour
from omniman_ros.viewer.view_state import ViewState

LAYER_HEIGHT = 0.004  #: Height of the lowest line, and of each layer above the one below [m]
DASH_LENGTH = 0.12  #: Length of a dash, and of the gap behind it [m]
MAX_DASHES = 500  #: Largest number of dashes of a line; the dashes of a longer line are longer
UNBOUNDED_WIDTH = 200.0  #: Width in any direction from which a workspace counts as unbounded [m]


class SceneLine:
    """A line that is sent again only when it has changed.

    Args:
        width: Width of the line [px].
        layer: Layer of a line on the floor: higher layers hide lower ones.
        jump: Length from which a segment is left out [m].
    """

    def __init__(
        self,
        api: viser.SceneApi,
        name: str,
        colour: Colour,
        width: float,
        layer: int,
        jump: float = math.inf,
        dashed: bool = False,
    ) -> None:
        self._version = 0
        self._height = LAYER_HEIGHT * layer
        self._jump = jump
        self._dashed = dashed
        self._handle = api.add_line_segments(
            name,
            np.zeros((1, 2, 3)),
            colour,
            thickness=width,
            thickness_units="screen",
            visible=False,
        )

    def show(self, points: Array, version: int) -> None:
        """Draw points (k, 2) on the floor or (k, 3) in space [m]; NaN breaks the line."""
        if version != self._version:
            self._version = version
            self.draw(self._segments(points))

    def draw(self, segments: Array) -> None:
        """Draw segments (s, 2, 3) [m]."""
        if len(segments):
            self._handle.points = segments.astype(np.float32)
        self._handle.visible = bool(len(segments))

    def _segments(self, points: Array) -> Array:
        if points.shape[1] == 3:
            pieces = np.stack([points[:-1], points[1:]], axis=1)
            known: Array = pieces[np.isfinite(pieces).all(axis=(1, 2))]
            return known
        flat = dashes(points) if self._dashed else segments(points, self._jump)
        full = np.full((len(flat), 2, 3), self._height)
        full[:, :, :2] = flat
        return full


def dashes(points: Array, dash: float = DASH_LENGTH, most: int = MAX_DASHES) -> Array:
    """Return the dashes (d, 2, 2) of a line (k, 2) [m]; the gaps are as long as the dashes."""
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 2:
        return np.zeros((0, 2, 2))
    arc_length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    count = min(max(math.ceil(0.5 * arc_length[-1] / dash), 1), most)
    # The number of intervals is odd, so that the line begins and ends with a dash.
    stops = np.linspace(0.0, arc_length[-1], 2 * count)
    ends = np.stack([np.interp(stops, arc_length, points[:, i]) for i in range(2)], axis=1)
    pieces: Array = ends.reshape(count, 2, 2)
    return pieces


def rectangle(bounds: tuple[float, float, float, float] | None) -> Array:
    """Return the outline (5, 2) of x_min, y_min, x_max, y_max [m]; (0, 2) if unbounded."""
    if bounds is None:
        return np.zeros((0, 2))
    x_min, y_min, x_max, y_max = bounds
    if not (x_max - x_min < UNBOUNDED_WIDTH and y_max - y_min < UNBOUNDED_WIDTH):
        return np.zeros((0, 2))
    return np.array(
        [[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max], [x_min, y_min]]
    )


class FloorScene:
    """The floor and the lines."""

    def __init__(self, api: viser.SceneApi, root: str) -> None:
        api.add_grid(
            f"{root}/floor",
            infinite_grid=True,
            cell_size=0.5,
            section_size=1.0,
            cell_thickness=0.6,
            section_thickness=1.0,
            cell_color=style.GRID_CELL,
            section_color=style.GRID_SECTION,
            fade_distance=40.0,
            shadow_opacity=0.0,
        )
        api.add_frame(f"{root}/odom", axes_length=0.3, axes_radius=0.008, origin_radius=0.012)
        self._workspace = SceneLine(api, f"{root}/workspace", style.WORKSPACE, 2.0, 1)
        self._bounds: tuple[float, float, float, float] | None = None
        self._route = SceneLine(api, f"{root}/route", style.ROUTE, 2.0, 2, dashed=True)
        self._path = SceneLine(api, f"{root}/path", style.PATH, 3.0, 3)
        self._truth_trail = SceneLine(api, f"{root}/ghost_trail", style.GHOST, 2.0, 4, JUMP)
        self._odom_trail = SceneLine(api, f"{root}/trail", style.TRAIL, 2.0, 5, JUMP)
        self._reference = SceneLine(api, f"{root}/reference", style.ACCENT, 4.0, 6)
        self._predicted = SceneLine(api, f"{root}/predicted", style.PREDICTED, 1.5, 7)
        self._plan = SceneLine(api, f"{root}/plan", style.PLAN, 4.0, 8)
        self._tool_path = SceneLine(api, f"{root}/tool_path", style.TOOL_PATH, 3.0, 8)

    def draw_motion(self, state: ViewState) -> None:
        """Draw reference and plan: short lines that move with the robot."""
        for line, content in ((self._reference, state.reference), (self._plan, state.plan)):
            line.show(content.points, content.version)

    def draw(self, state: ViewState) -> None:
        """Draw the lines that are long or rarely change."""
        for line, content in (
            (self._route, state.route),
            (self._path, state.path),
            (self._truth_trail, state.truth_trail),
            (self._odom_trail, state.odom_trail),
            (self._predicted, state.predicted),
            (self._tool_path, state.tool_path),
        ):
            line.show(content.points, content.version)
        if state.workspace != self._bounds:
            self._bounds = state.workspace
            corners = rectangle(state.workspace)
            flat = np.column_stack([corners, np.full(len(corners), LAYER_HEIGHT)])
            self._workspace.draw(np.stack([flat[:-1], flat[1:]], axis=1))
