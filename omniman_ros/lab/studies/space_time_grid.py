"""The robot and the grid of a space-time search, and the gaps that grid nodes keep to bodies."""

import math
from dataclasses import dataclass

from omniman_ros.core.errors import InputError
from omniman_ros.lab.studies.scene_geometry import Box
from omniman_ros.lab.studies.scene_judge import CONTACT_GAP

STRIDE = math.sqrt(5.0)
"""Length of the longest step in x and y [cells]: that of a knight's move in chess, so that steps
reach about equally far in all directions."""
SUBCELLS = 4
"""Number of parts into which the edge of a cell is divided for rounding the positions of moving
obstacles."""
SAFETY = 2.0 * CONTACT_GAP
"""Additional part of every gap that nodes keep, so that the judge finds no contact [m]."""


@dataclass(frozen=True)
class Mover:
    """The robot of a search: its outline and its largest speeds; accelerations are not limited.

    Attributes:
        box: The robot's outline.
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
        InputError: The cell is not above zero and finite, or the number of headings is neither.
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
        """Angle between neighbouring headings [rad]."""
        return math.tau / self.headings

    def step(self, mover: Mover) -> float:
        """Return the duration of a step [s]."""
        return max(STRIDE * self.cell / mover.speed, self.angle / mover.yaw_rate)

    def turn(self, mover: Mover) -> int:
        """Return the largest number of headings by which the robot rotates in a step."""
        return max(1, math.floor(mover.yaw_rate * self.step(mover) / self.angle + 1e-9))

    def bulge(self, mover: Mover) -> float:
        """Return the largest distance of the box's points from their chords in a step [m].

        The chord of a point connects its positions before and after the rotation of the step.
        """
        return mover.box.radius * (self.turn(mover) * self.angle) ** 2 / 8.0

    def ellipse_margin(self, mover: Mover, semi_axes: tuple[float, float], speed: float) -> float:
        """Return the gap that nodes keep to an ellipse [m].

        Args:
            mover: The robot.
            semi_axes: Semi-axes of the ellipse [m].
            speed: Largest speed of the ellipse [m/s]; 0 if it is fixed.
        """
        radius = min(semi_axes) ** 2 / max(semi_axes)
        rounding = math.sqrt(0.5) * self.cell / SUBCELLS if speed > 0.0 else 0.0
        half = 0.5 * self._travel(mover, speed)
        return math.hypot(radius + self.bulge(mover), half) - radius + rounding + SAFETY

    def wall_margin(self, mover: Mover, turning: bool) -> float:
        """Return the gap that nodes keep to a wall [m].

        Args:
            mover: The robot.
            turning: Whether the gap is for steps in which the robot rotates while it drives.
        """
        if turning:
            return math.hypot(self.bulge(mover), 0.5 * self._travel(mover, 0.0)) + SAFETY
        in_place = 0.5 * mover.box.radius * self.turn(mover) * self.angle
        drive = mover.speed * self.step(mover)
        across = 0.5 * (drive - min(mover.box.length, mover.box.width))
        turn = math.hypot(self.bulge(mover), in_place)
        return max(drive / math.sqrt(8.0), across, turn) + SAFETY

    def sufficient_gap(self, mover: Mover, kept: float) -> float:
        """Return the gap of a path to fixed bodies with which the path is certain to be found [m].

        The nearest node deviates from a pose by up to half a cell in x and y, and by up to half
        the angle between headings. For moving bodies, the value is a guide only: a path along the
        nodes may take longer than the exact path, and the bodies have moved by then.

        Args:
            mover: The robot.
            kept: Gap that nodes keep to the bodies [m].
        """
        return kept + math.sqrt(0.5) * self.cell + 0.5 * self.angle * mover.box.radius

    def _travel(self, mover: Mover, speed: float) -> float:
        """Return the farthest that any point of the box travels in a step [m].

        The travel is relative to an obstacle.

        Args:
            mover: The robot.
            speed: Speed of the obstacle [m/s].
        """
        drive = mover.speed * self.step(mover)
        turn = mover.box.radius * self.turn(mover) * self.angle
        return drive + turn + speed * self.step(mover)


GRIDS = (Grid(0.05, 64), Grid(0.025, 128))
"""Grids that are tried one after the other. Most paths are found on the first, which takes a tenth
of the time.

For a robot of 0.8 m by 0.5 m with 1 m/s and 2 rad/s, the second grid finds paths with a gap of
3.4 cm to fixed discs of 0.3 m radius, 4.2 cm to discs that move at 0.6 m/s, and 5.3 cm to walls.
"""
FINE_GRIDS = (*GRIDS, Grid(0.0125, 128))
"""Grids for narrow passages. For the same robot, a gap of 3.2 cm to walls and of 2.5 cm to moving
discs suffices.

The third grid, which is used if no path is found on the first two, takes about eight times as long
as the second.
"""
