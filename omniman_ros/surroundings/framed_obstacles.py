"""Obstacles that are observed in several frames, each tracked in its own."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.core.transform_tree import ODOM
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.obstacles import (
    Key,
    Observation,
    ObstacleParameters,
    ObstacleSet,
)


class FramedObstacles:
    """Obstacles by their keys, each tracked in the frame in which it is observed.

    A localisation that corrects itself moves what stands in `map` all at once; tracked in odom,
    all of it would seem to drive off.
    """

    def __init__(self, parameters: ObstacleParameters) -> None:
        self._parameters = parameters
        self._sets = {ODOM: ObstacleSet(parameters)}

    def __len__(self) -> int:
        return sum(map(len, self._sets.values()))

    def configure(self, parameters: ObstacleParameters) -> None:
        """Use other parameters; existing tracks keep those they began with."""
        self._parameters = parameters
        for obstacles in self._sets.values():
            obstacles.configure(parameters)

    def add(self, observation: Observation, now: float) -> None:
        """Add an observation at a time [s]; see `ObstacleSet.add`.

        Raises:
            InputError: The observation is ahead of `now`, or there are too many obstacles.
        """
        if observation.frame not in self._sets:
            self._sets[observation.frame] = ObstacleSet(self._parameters)
        self._sets[observation.frame].add(observation, now)
        for frame, obstacles in self._sets.items():
            if frame != observation.frame:
                obstacles.delete(observation.key)

    def delete(self, key: Key) -> None:
        """Delete an obstacle if it is known."""
        for obstacles in self._sets.values():
            obstacles.delete(key)

    def delete_all(self, namespace: str = "") -> None:
        """Delete all obstacles, or those of a namespace."""
        for obstacles in self._sets.values():
            obstacles.delete_all(namespace)

    def ellipses(self, now: float, anchor: Callable[[str], PlanarPose]) -> Ellipses:
        """Return the obstacles at a time [s] in odom, in the order of `keys`.

        Args:
            anchor: Returns the pose of a frame in odom [m, m, rad].
        """
        result = self._sets[ODOM].ellipses(now)
        for frame, obstacles in self._sets.items():
            if frame != ODOM and len(obstacles):
                result = result.joined(_displaced(obstacles.ellipses(now), anchor(frame)))
        return result

    @property
    def keys(self) -> tuple[Key, ...]:
        """Keys of the obstacles, in the order of `ellipses` at the same time."""
        return tuple(key for obstacles in self._sets.values() for key in obstacles.keys)


def _displaced(ellipses: Ellipses, frame: PlanarPose) -> Ellipses:
    """Return obstacles that are given in a frame, by the pose of that frame [m, m, rad]."""
    poses = np.column_stack([ellipses.centers, ellipses.angles])
    poses = se2.displaced(poses, frame)
    velocities = np.column_stack([ellipses.velocities, np.zeros(len(ellipses))])
    velocities = se2.displaced(velocities, (0.0, 0.0, frame[2]))
    return replace(
        ellipses, centers=poses[:, :2], angles=poses[:, 2], velocities=velocities[:, :2]
    )
