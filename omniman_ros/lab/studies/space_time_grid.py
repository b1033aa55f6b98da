"""The robot and the grid of a space-time search, and the gaps that grid nodes keep."""

import math
from dataclasses import dataclass

from omniman_ros.core.errors import InputError
from omniman_ros.lab.studies.scene_geometry import Box
from omniman_ros.lab.studies.scene_judge import TOUCH

STRIDE = math.sqrt(5.0)
"""Length of the largest step [cells]: a knight's move, so that steps reach about equally far in
all directions."""
SUBCELLS = 4
"""Number of parts of a cell to which the positions of moving obstacles are rounded."""
SAFETY = 2.0 * TOUCH
"""Gap that is kept in addition to all others, so that the judge finds no contact [m]."""


@dataclass(frozen=True)
class Mover:
    """The robot of a search: its outline and its largest speeds.

    Attributes:
        box: Outline.
        speed: Largest speed in any direction [m/s].
        yaw_rate: Largest yaw rate [rad/s].

    Raises:
        InputError: A limit is not above zero and finite.
    """

    box: Box
    speed: float
    yaw_rate: float

    def __post_init__(self) -> None:
        for name in ("speed", "yaw_rate"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} must be above zero, got {getattr(self, name)}")


@dataclass(frozen=True)
class Grid:
    """The resolution of a search.

    Attributes:
        cell: Distance between neighbouring nodes [m].
        headings: Number of headings in a full turn, 64 or 128.

    Raises:
        InputError: The cell is not above zero, or the number of headings is neither.
    """

    cell: float
    headings: int

    def __post_init__(self) -> None:
        if not 0.0 < self.cell < math.inf:
            raise InputError(f"the cell must be above zero, got {self.cell} m")
        if self.headings not in (64, 128):
            raise InputError(f"headings must be 64 or 128, got {self.headings}")

    @property
    def angle(self) -> float:
        """Angle between two headings [rad]."""
        return math.tau / self.headings

    def step(self, mover: Mover) -> float:
        """Return the duration of a step [s]."""
        return max(STRIDE * self.cell / mover.speed, self.angle / mover.yaw_rate)

    def turn(self, mover: Mover) -> int:
        """Return the largest number of headings by which a step rotates."""
        return max(1, math.floor(mover.yaw_rate * self.step(mover) / self.angle + 1e-9))

    def bulge(self, mover: Mover) -> float:
        """Return the largest distance of points of the box from their chords in a rotation [m]."""
        return mover.box.radius * (self.turn(mover) * self.angle) ** 2 / 8.0

    def kept_to_ellipse(self, mover: Mover, semi_axes: tuple[float, float], speed: float) -> float:
        """Return the gap that nodes keep to an ellipse [m].

        Args:
            mover: The robot.
            semi_axes: Semi-axes of the ellipse [m].
            speed: Largest speed of the ellipse [m/s].
        """
        radius = min(semi_axes) ** 2 / max(semi_axes)
        rounding = math.sqrt(0.5) * self.cell / SUBCELLS if speed > 0.0 else 0.0
        half = 0.5 * self._travel(mover, speed)
        return math.hypot(radius + self.bulge(mover), half) - radius + rounding + SAFETY

    def kept_to_wall(self, mover: Mover, turning: bool) -> float:
        """Return the gap that nodes keep to a wall [m].

        Args:
            mover: The robot.
            turning: Whether the gap is for steps that rotate while they drive.
        """
        if turning:
            return math.hypot(self.bulge(mover), 0.5 * self._travel(mover, 0.0)) + SAFETY
        in_place = 0.5 * mover.box.radius * self.turn(mover) * self.angle
        drive = mover.speed * self.step(mover)
        across = 0.5 * (drive - min(mover.box.length, mover.box.width))
        turn = math.hypot(self.bulge(mover), in_place)
        return max(drive / math.sqrt(8.0), across, turn) + SAFETY

    def spare(self, mover: Mover, kept: float) -> float:
        """Return the gap with which a path among fixed bodies is certain to be found [m].

        The nearest node deviates by half a cell in x and y, and by half an angle in heading. For
        moving bodies the value is a guide only: the searched path may need more time than the
        exact one, and the obstacles have then moved.

        Args:
            mover: The robot.
            kept: Gap that nodes keep [m].
        """
        return kept + math.sqrt(0.5) * self.cell + 0.5 * self.angle * mover.box.radius

    def _travel(self, mover: Mover, speed: float) -> float:
        """Return the longest chord of a point of the box in a step, relative to an obstacle [m].

        Args:
            mover: The robot.
            speed: Speed of the obstacle [m/s].
        """
        drive = mover.speed * self.step(mover)
        turn = mover.box.radius * self.turn(mover) * self.angle
        return drive + turn + speed * self.step(mover)


GRIDS = (Grid(0.05, 64), Grid(0.025, 128))
"""Grids that are tried one after the other. Most paths are found on the first, which needs a tenth
of the time.

For a robot of 0.8 m by 0.5 m at 1 m/s and 2 rad/s, the second finds paths with a gap of 3.4 cm to
fixed discs of 0.3 m radius, 4.2 cm to discs that move at 0.6 m/s, and 5.3 cm to walls.
"""
FINE = (*GRIDS, Grid(0.0125, 128))
"""Grids for narrow passages: for that robot, 3.2 cm to walls and 2.5 cm to moving discs.

If the first two find no path, the third needs about eight times as long.
"""
