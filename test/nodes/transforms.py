"""Transforms for tests: the messages of tf2_msgs, and a localisation that drifts and jumps."""

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped

from omniman_ros.nodes import tf_messages
from test import ros_interfaces
from test.nodes.harness import World

Pose = tuple[float, float, float]


@contextmanager
def tf_installed() -> Iterator[None]:
    """Let nodes that are made within publish and receive transforms."""
    with ros_interfaces.installed("tf2_msgs"), pytest.MonkeyPatch.context() as patch:
        from tf2_msgs.msg import TFMessage

        patch.setattr(tf_messages, "TFMessage", TFMessage)
        yield


def transform(parent: str, child: str, stamp: Any, pose: Pose) -> TransformStamped:
    """Return the transform of a child that has a pose in its parent."""
    made = TransformStamped(child_frame_id=child)
    made.header.frame_id, made.header.stamp = parent, stamp
    made.transform.translation.x, made.transform.translation.y = pose[:2]
    made.transform.rotation.z, made.transform.rotation.w = (
        math.sin(0.5 * pose[2]),
        math.cos(0.5 * pose[2]),
    )
    return made


class Transforms:
    """Publishes transforms with the probe of a world."""

    def __init__(self, world: World) -> None:
        self._world = world
        kind = tf_messages.TFMessage
        self._moving = world.publisher(kind, tf_messages.TOPIC, 100)
        self._static = world.publisher(
            kind, tf_messages.STATIC_TOPIC, tf_messages.STATIC_PUBLISHER
        )

    def send(
        self, parent: str, child: str, *pose: float, age: float = 0.0, static: bool = False
    ) -> None:
        """Publish a transform with a pose (x, y, theta)."""
        made = transform(parent, child, self._world.stamp(-age), (*pose, 0.0, 0.0, 0.0)[:3])
        self.send_all([made], static=static)

    def send_all(self, transforms: Iterable[TransformStamped], *, static: bool = False) -> None:
        """Publish transforms in one message."""
        publisher = self._static if static else self._moving
        publisher.publish(tf_messages.TFMessage(transforms=list(transforms)))


class Localisation:
    """Publishes map -> odom, which drifts and jumps while odom does not.

    Args:
        world: World whose time it follows.
        start: Pose of odom in map at first [m, m, rad].
        drift: Speed of the drift [m/s], in a direction that turns.
        jumps: Jumps by their times after the start: distance [m], direction [rad], turn [rad];
            about `center`, a point in odom.
    """

    PERIOD = 0.1

    def __init__(
        self,
        world: World,
        transforms: Transforms,
        start: Pose = (0.0, 0.0, 0.0),
        drift: float = 0.0,
        jumps: dict[float, Pose] | None = None,
    ) -> None:
        self._world, self._transforms = world, transforms
        self.matrix = self._of(*start)
        self._drift, self._jumps = drift, dict(jumps or {})
        self._begin = self._sent = world.time
        self.center = np.zeros(2)
        self.is_silent = False
        self.jumped = 0
        self._send()
        world.hooks.append(self._step)

    @staticmethod
    def _of(x: float, y: float, theta: float) -> np.ndarray:
        c, s = math.cos(theta), math.sin(theta)
        return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])

    def _step(self) -> None:
        if self._world.time < self._sent + self.PERIOD - 1e-9:
            return
        elapsed, self._sent = self._world.time - self._sent, self._world.time
        way = self._drift * elapsed
        direction = 0.1 * (self._world.time - self._begin)
        self.matrix[:2, 2] += way * math.cos(direction), way * math.sin(direction)
        for due in [at for at in self._jumps if self._world.time >= self._begin + at]:
            distance, direction, turn = self._jumps.pop(due)
            fixed = self.matrix @ np.array([*self.center, 1.0])
            about = self._of(fixed[0], fixed[1], 0.0)
            self.matrix = about @ self._of(0.0, 0.0, turn) @ np.linalg.inv(about) @ self.matrix
            self.matrix[:2, 2] += distance * math.cos(direction), distance * math.sin(direction)
            self.jumped += 1
        self._send()

    def _send(self) -> None:
        if not self.is_silent:
            theta = math.atan2(self.matrix[1, 0], self.matrix[0, 0])
            self._transforms.send("map", "odom", *self.matrix[:2, 2].tolist(), theta)

    def in_map(self, pose: np.ndarray) -> np.ndarray:
        """Return a pose in odom as a pose in map."""
        point = self.matrix @ np.array([pose[0], pose[1], 1.0])
        return np.array([*point[:2], pose[2] + math.atan2(self.matrix[1, 0], self.matrix[0, 0])])
