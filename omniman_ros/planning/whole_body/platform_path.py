"""The platform's way along the path of the tool, as a search finds it."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.validated import Validated
from omniman_ros.motion.whole_body.tool_timing import PlatformSpline
from omniman_ros.planning.whole_body.obstruction import Obstruction


class NoPathError(InputError):
    """There is no way for the platform; the message says where, and what is in the way."""

    def __init__(self, message: str, obstruction: Obstruction) -> None:
        super().__init__(message)
        self.obstruction = obstruction


@dataclass(frozen=True)
class PlatformPath(Validated):
    """Poses of the platform at equally spaced places of the tool's path, joined smoothly.

    Where the tool's orientation is free, its free coordinates follow those of each pose: c are 3
    or more.
    """

    start: float  #: Parameter of the tool's path at the first pose [m]
    end: float  #: Parameter at the last pose [m]
    #: Poses (n + 1, c) of base_link in odom, headings not wrapped [m, m, rad]
    poses: Annotated[Array, Shape("n", "c")]

    def at(self, places: Array) -> tuple[Array, Array]:
        """Return poses (k, c) at places (k,) [m], held at the ends, and their derivatives."""
        length = max(self.end - self.start, 1e-9)
        inside = np.clip(places - self.start, 0.0, length)
        pose, slope, _ = PlatformSpline(self.poses, length).motion(inside)
        held = (places < self.start) | (places > self.end)
        slope[held] = 0.0
        return pose, slope
