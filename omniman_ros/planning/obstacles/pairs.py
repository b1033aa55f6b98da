"""Pairs of an obstacle and a part of the robot at the same height."""

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.surroundings.ellipses import Ellipses


@dataclass(frozen=True)
class Pairs:
    """M pairs of a rectangle of the robot and an obstacle, which may touch each other."""

    footprint: Footprint  #: Outline of the robot
    boxes: Rectangles  #: Rectangles (M,) of the robot, or one for all pairs
    ellipses: Ellipses  #: Obstacles (M,); one obstacle may be in several pairs, or in none

    def __len__(self) -> int:
        return len(self.ellipses)

    @staticmethod
    def of(footprint: Footprint, ellipses: Ellipses) -> "Pairs":
        """Return all pairs of a part of the robot and an obstacle whose heights overlap."""
        boxes, index = footprint.against(ellipses.lower, ellipses.upper)
        return Pairs(footprint, boxes, ellipses.select(index))

    def select(self, indices: NDArray[Any]) -> "Pairs":
        """Return the pairs with these indices, in their order, or those of a mask."""
        return Pairs(self.footprint, self.boxes.select(indices), self.ellipses.select(indices))
