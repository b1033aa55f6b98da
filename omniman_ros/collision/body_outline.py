"""Footprints of a robot with an arm, from the postures of the arm."""

import numpy as np

from omniman_ros.collision.arm_segments import ArmSegments
from omniman_ros.collision.footprint import Footprint, Limbs
from omniman_ros.collision.load_box import LoadBox
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.description.platform_shape import platform_top
from omniman_ros.description.urdf import carries_arm

#: Number of the link, from the arm's base, from which on links share a rectangle with tool and
#: load; the links before it share another one.
FIRST_WRIST = 4
#: Largest sum of all joints' rotations between two postures that are looked at [rad]
SWEEP_ANGLE = 0.1
#: Largest sum of all joints' distances of a posture from the straight line that replaces it [rad]
DEVIATION = 0.01


class BodyOutline:
    """Makes footprints of a robot from the postures of its arm."""

    def __init__(
        self,
        description: DescriptionParameters,
        tool: ToolShape | None = None,
        load: LoadShape | None = None,
    ) -> None:
        robot, mount = description.robot, description.mount
        self.has_arm = carries_arm(robot)
        self._platform = Rectangles.around(robot.body)
        self._heights = 0.0, platform_top(robot, mount.z if self.has_arm else None)
        self._arm = ArmSegments(mount, tool or ToolShape())
        self._load = LoadBox(load) if load is not None and load.is_carried else None
        last = len(self._arm.names) - 1
        extent = max(self._arm.extent(last), self._load.extent if self._load else 0.0)
        self._lever_arm = float(self._arm.lever_arms(0, JOINTS, extent).max())

    def footprint(self, configurations: Array, margin: float) -> Footprint:
        """Return the footprint of the robot while its arm goes through postures (k, 6) [rad].

        Between two postures the joints move along a straight line. A point of the arm is then
        never farther from the chord between its places at two postures than d s^2 / 8, where d is
        its largest distance from an axis and s is the sum of all joints' rotations: its
        acceleration is at most d times the square of the sum of their rates. Postures that are
        nearly on a straight line of the joints are left out: a point is no farther from that line
        than d times DEVIATION. Both are added to the arm's radii.

        An obstacle within the vertical gap `margin` [m] counts as being at the height of a part.

        Raises:
            InputError: The shape is wrong, or an angle is not finite.
        """
        if not self.has_arm:
            return Footprint(self._platform, self._heights, None, margin)
        if (
            configurations.ndim != 2
            or configurations.shape[1] != JOINTS
            or not len(configurations)
        ):
            raise InputError(f"postures have shape {configurations.shape}, expected (k, {JOINTS})")
        if not np.isfinite(configurations).all():
            raise InputError("joint angles must be finite")
        return Footprint(self._platform, self._heights, self._limbs(configurations), margin)

    def _limbs(self, configurations: Array) -> Limbs:
        """Return the limbs in all postures (k, 6) and between them."""
        kept = _simplified(configurations)
        fine = _refined(kept)
        sag = 0.125 * self._lever_arm * SWEEP_ANGLE**2 if len(fine) > 1 else 0.0
        sag += self._lever_arm * DEVIATION if len(kept) < len(configurations) else 0.0
        arm, count = self._arm, len(fine)
        frames = arm.frames(fine)
        axes = arm.capsules(frames)
        parts = [(axes, arm.radius + sag, np.where(arm.link < FIRST_WRIST, 0, 1))]
        if self._load is not None:
            edges = self._load.edges(frames[:, -1])
            each = edges.start.shape[-1]
            parts.append((edges, np.full(each, sag), np.ones(each, dtype=np.intp)))
        return Limbs(
            np.concatenate([segments.start.reshape(3, -1) for segments, _, _ in parts], axis=1),
            np.concatenate([segments.end.reshape(3, -1) for segments, _, _ in parts], axis=1),
            np.concatenate([np.tile(radius, count) for _, radius, _ in parts]),
            np.concatenate([np.tile(group, count) for _, _, group in parts]),
        )


def _simplified(configurations: Array) -> Array:
    """Return postures (n, 6) on straight lines to DEVIATION, by Douglas and Peucker."""
    way = np.abs(np.diff(configurations, axis=0)).sum(axis=1)
    along = np.concatenate([[0.0], np.cumsum(way)])
    kept, open_parts = {0, len(configurations) - 1}, [(0, len(configurations) - 1)]
    while open_parts:
        first, last = open_parts.pop()
        if last - first < 2:
            continue
        length = max(along[last] - along[first], np.finfo(float).tiny)
        fraction = (along[first + 1 : last] - along[first]) / length
        line = configurations[first] + fraction[:, None] * (
            configurations[last] - configurations[first]
        )
        off = np.abs(configurations[first + 1 : last] - line).sum(axis=1)
        worst = int(off.argmax())
        if off[worst] > DEVIATION:
            middle = first + 1 + worst
            kept.add(middle)
            open_parts += [(first, middle), (middle, last)]
    return configurations[sorted(kept)]


def _refined(configurations: Array) -> Array:
    """Return postures (n, 6), between two of which the joints rotate by at most SWEEP_ANGLE."""
    sums = np.abs(np.diff(configurations, axis=0)).sum(axis=1)
    along = np.concatenate([[0.0], np.cumsum(np.ceil(sums / SWEEP_ANGLE))])
    steps = np.arange(along[-1] + 1.0)
    keep = np.concatenate([[True], np.diff(along) > 0.0])
    return np.column_stack(
        [np.interp(steps, along[keep], axis[keep]) for axis in configurations.T]
    )
