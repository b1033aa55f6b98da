"""The tool's goal on the page: a handle that is led by hand, and the poses of a path."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.core.planar import Triple

Quaternion = tuple[float, float, float, float]  #: A rotation (w, x, y, z)
MOST_POSES = 50  #: Largest number of poses of a path
_LEAST_LENGTH = 1e-3  #: Least length of a quaternion that still tells a rotation [-]


@dataclass(frozen=True)
class ToolPose:
    """A pose of `tool0` in `odom`."""

    position: Triple  #: x, y, z [m]
    rotation: Quaternion  #: The rotation, of unit length

    @staticmethod
    def checked(position: Triple, rotation: Quaternion) -> "ToolPose":
        """Return a pose that a page has sent; an implausible one raises an InputError."""
        plausible.demand(np.array(position), plausible.LENGTH, "tool: position")
        plausible.demand(np.array(rotation), plausible.LENGTH, "tool: rotation")
        length = math.hypot(*rotation)
        if length < _LEAST_LENGTH:
            raise InputError(f"tool: the rotation {rotation} has no length")
        x, y, z = (float(value) for value in position)
        w, i, j, k = (float(value) / length for value in rotation)
        return ToolPose((x, y, z), (w, i, j, k))


class ToolGoal:
    """The handle, and the poses before it; what is not possible raises an InputError."""

    def __init__(self) -> None:
        self.handle: ToolPose | None = None  #: Pose of the handle; None while there is none
        self.poses: tuple[ToolPose, ...] = ()  #: Poses that the tool passes before the handle

    def place(self, pose: ToolPose) -> None:
        """Place the handle, and begin a new path."""
        self.handle, self.poses = pose, ()

    def move(self, pose: ToolPose) -> None:
        """Move the handle."""
        if self.handle is None:
            raise InputError("there is no handle yet: Place handle")
        self.handle = pose

    def add(self) -> None:
        """Have the path pass through the pose of the handle."""
        path = self.path
        if self.poses == path:
            raise InputError("move the handle first: the path ends there already")
        if len(path) >= MOST_POSES:
            raise InputError(f"a path has at most {MOST_POSES} poses")
        self.poses = path

    def remove(self) -> None:
        """Remove the handle and the path."""
        self.handle, self.poses = None, ()

    @property
    def path(self) -> tuple[ToolPose, ...]:
        """The path: the poses, and the handle's unless that is the last one of them."""
        if self.handle is None:
            raise InputError("there is no handle yet: Place handle")
        if self.poses and self.poses[-1] == self.handle:
            return self.poses
        return (*self.poses, self.handle)
