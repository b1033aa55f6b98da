"""Correction of the tool's pose by the arm for the platform's tracking error.

Source: CCTA 2017 V.A, platform and arm on one time base. The platform deviates from its reference
by some millimetres, and by milliradians, which become millimetres at the arm's reach. The joint
angles are therefore those that bring the tool to its reference from the expected pose of the
platform: its reference plus its error, which is filtered and extrapolated over the time from the
measurement until the arm has moved.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from omniman_ros.core import plausible, se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.axes import JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.pace import Pace, Window
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions

#: Time constant with which the error rate decays, as the platform controller corrects it [s]
RATE_DECAY_TIME = 0.3
MAX_GAP = 0.25  #: Time without a measurement after which the filter is reset [s]
MIN_SCALED_PACE = 0.1  #: Lowest pace from which joint speeds are scaled to another pace
#: Number of consecutive measurements beyond the largest error that are no longer outliers
OUTLIER_COUNT = 3
#: Number of steps between a pace of 0 and 1; fewer changes of the pace disturb the motion less
PACE_STEPS = 20
FULL_PACE_ERROR = 0.5  #: Fraction of the largest error up to which the motion is not slowed down


class PlatformCorrection:
    """The platform's tracking error in odom, from its measured poses.

    An alpha-beta filter with a double pole follows an error that changes at a constant rate
    without lag. For this kind of filter see T. R. Benedict and G. W. Bordner, "Synthesis of an
    optimal set of radar track-while-scan smoothing equations" (1962).

    Args:
        options: Bounds and filter of the correction; may be replaced at any time.

    Attributes:
        error: (3,) filtered measured minus reference pose at the last measurement [m, m, rad].
        rate: (3,) rate of the error [m/s, m/s, rad/s].
        time: Time of the last measurement [s]; minus infinity before the first.
    """

    def __init__(self, options: ToolPathOptions) -> None:
        self.options = options
        self.error: Array = np.zeros(3)
        self.rate: Array = np.zeros(3)
        self.time = -math.inf
        self._outliers = 0

    def update(self, time: float, measured: Array, reference: Array) -> None:
        """Update the filter with a measured pose.

        Args:
            measured: (3,) pose of base_link in odom [m, m, rad], modulo whole revolutions.
            reference: (3,) reference pose at that time [m, m, rad].

        Raises:
            InputError: The pose is not finite, not newer than the last one, or an outlier beyond
                the largest error; the error is not changed.
        """
        if not time > self.time:
            raise InputError(
                f"the pose is of {time:.3f} s, not newer than the last one of {self.time:.3f} s"
            )
        plausible.demand(measured[:2], plausible.LENGTH, "position")
        plausible.demand(measured[2:], plausible.ANGLE, "heading")
        raw = measured - reference
        raw[2] = se2.wrap(float(raw[2]))
        step = time - self.time
        self.time = time
        if float(self._ratios(raw[None])[0]) > 1.0:
            self._outliers += 1
            if self._outliers < OUTLIER_COUNT:
                raise InputError(
                    f"the platform would be {math.hypot(raw[0], raw[1]):.3f} m and "
                    f"{raw[2]:.3f} rad off its path"
                )
            self.error, self.rate = raw, np.zeros(3)
            return
        self._outliers = 0
        if step > MAX_GAP:
            self.error, self.rate = raw, np.zeros(3)
            return
        pole = math.exp(-self.options.correction_bandwidth * step)
        expected = self.error + step * self.rate
        innovation = raw - expected
        self.error = expected + (1.0 - pole * pole) * innovation
        self.rate = self.rate + (1.0 - pole) ** 2 / step * innovation

    def error_at(self, times: Array) -> Array:
        """Return the errors (k, 3) [m, m, rad] expected at times (k,) [s], within the bounds.

        The rate decays after the last measurement; before it, the error is that of the
        measurement. The error is zero without correction, and before the first measurement.
        """
        if not self.options.correction or math.isinf(self.time):
            return np.zeros((len(times), 3))
        age = np.maximum(times - self.time, 0.0)
        effective_time = -RATE_DECAY_TIME * np.expm1(-age / RATE_DECAY_TIME)
        expected: Array = self.error + effective_time[:, None] * self.rate
        return expected / np.maximum(self._ratios(expected), 1.0)[:, None]

    def platform_at(self, reference: Array, times: Array) -> Array:
        """Return the expected poses (k, 3) of the platform [m, m, rad].

        Args:
            reference: (k, 3) reference poses [m, m, rad].
            times: (k,) times of the poses [s].
        """
        result: Array = reference + self.error_at(times)
        return result

    @property
    def error_ratio(self) -> float:
        """Error relative to the largest that is corrected; above 1 the motion is abandoned."""
        return float(self._ratios(self.error[None])[0])

    @property
    def excess(self) -> str:
        """The error in words if it is beyond its bounds, or else an empty string."""
        x, y, theta = self.error
        return f"{math.hypot(x, y):.3f} m and {theta:.3f} rad" if self.error_ratio > 1.0 else ""

    def max_pace(self) -> float:
        """Return the highest pace of the motion, 0 to 1, lower as the error nears its bound."""
        return min(max((1.0 - self.error_ratio) / (1.0 - FULL_PACE_ERROR), 0.0), 1.0)

    def _ratios(self, errors: Array) -> Array:
        """Return the larger ratio (k,) of distance and heading errors (k, 3) to their bounds."""
        distance = np.hypot(errors[:, 0], errors[:, 1]) / self.options.max_error
        heading = np.abs(errors[:, 2]) / self.options.max_heading_error
        return np.maximum(distance, heading)


def corrected_arm_motion(
    model: WholeBodyModel, platform: Array, tool: Array, branch: int, near: Array, step: float
) -> tuple[Array, Array, Array]:
    """Return the joint motion that keeps the tool on its path.

    The derivatives are central differences, so that changes of the pace are contained in them.

    Args:
        platform: (k + 2, 3) poses of base_link [m, m, rad], from a step before the first result to
            a step after the last.
        tool: (k + 2, 4, 4) poses of `tool0` in odom at the same times.
        branch: Branch of the arm's inverse kinematics, :meth:`ArmModel.inverse`.
        near: (k + 2, 6) planned angles [rad]; each result is within half a revolution of them.

    Returns:
        Joint angles [rad], rates [rad/s] and second derivatives [rad/s^2], (k, 6) each.

    Raises:
        InputError: The tool cannot be reached from the platform.
    """
    q = model.arm_angles(platform, tool, branch, near)
    if not np.isfinite(q).all():
        k = int(np.argmin(np.isfinite(q).all(axis=1)))
        x, y, z = tool[k, :3, 3]
        raise InputError(
            f"tool0 at ({x:.3f}, {y:.3f}, {z:.3f}) m is out of the arm's reach from where the "
            f"platform is ({platform[k, 0]:.3f} m, {platform[k, 1]:.3f} m, {platform[k, 2]:.3f} "
            "rad)"
        )
    rate = (q[2:] - q[:-2]) / (2.0 * step)
    acceleration = (q[2:] - 2.0 * q[1:-1] + q[:-2]) / (step * step)
    return q[1:-1], rate, acceleration


def joint_speed_pace(velocities: Array, limits: Array, pace: float = 1.0) -> float:
    """Return the highest pace, 0 to 1, at which all joints keep their speed limits.

    Args:
        velocities: (k, n) predicted joint rates at the present pace [rad/s].
        limits: (n,) limits of the joint rates [rad/s].
    """
    utilisation = float((np.abs(velocities) / limits).max(initial=0.0))
    reference_pace = max(pace, MIN_SCALED_PACE)  # at rest, the speed at full pace is unknown
    return min(reference_pace / max(utilisation, 1e-9), 1.0)


class LedTool(Protocol):
    """The tool of a planned motion."""

    @property
    def branch(self) -> int:
        """Branch of the arm's inverse kinematics."""

    def tool(self, times: Array) -> Array:
        """Return poses (m, 4, 4) of `tool0` in odom at times (m,) of the motion [s]."""


class ToolStream:
    """A tool path under way, whose joint angles are corrected for the platform's error.

    Args:
        velocity: (6,) limits of the joint speeds [rad/s].
    """

    def __init__(
        self,
        model: WholeBodyModel,
        plan: LedTool,
        correction: PlatformCorrection,
        velocity: tuple[float, ...],
    ) -> None:
        self._model, self.plan, self._velocity = model, plan, np.array(velocity)
        self.correction = correction
        self._joint_pace: float = 1.0
        self._arm_offset: Array = np.zeros(len(velocity))

    @property
    def max_pace(self) -> float:
        """Highest pace at which the path may be driven, 0 to 1."""
        steps = np.floor(PACE_STEPS * min(self.correction.max_pace(), self._joint_pace))
        return max(float(steps), 1.0) / PACE_STEPS  # a pace of 0 would remain 0

    def corrected(
        self,
        times: Array,
        pace: Pace,
        sample: Callable[[Array], tuple[Array, Array, Array]],
        plan_times: Callable[[Array], Array],
    ) -> tuple[Window, Array]:
        """Return all axes (k, 9) at times (k,) [s], corrected, and the tool's pose.

        The times are equally spaced by a tick or several.

        Args:
            sample: Returns x, x', x'' (k, 9) of the planned motion at motion times (k,) [s]; the
                derivatives of the joints are not used.
            plan_times: Returns the times (k,) of the tool's motion at motion times (k,) [s].

        Returns:
            The corrected stretch, and the planned pose (4, 4) of `tool0` in odom at its begin.

        Raises:
            InputError: The tool cannot be reached from the platform.
        """
        # The times are padded by one on either side, for central differences.
        step = _spacing(times)
        padded = np.concatenate([times[:1] - step, times, times[-1:] + step])
        paced = pace.sample(padded)
        due = plan_times(paced.motion)
        planned = paced.apply(*sample(paced.motion))
        tool, near = self.plan.tool(due), planned[0][:, JOINT_COLUMNS]
        platform = self.correction.platform_at(planned[0][:, PLATFORM_COLUMNS], padded)
        arm = corrected_arm_motion(self._model, platform, tool, self.plan.branch, near, step)
        self._joint_pace = joint_speed_pace(arm[1], self._velocity, float(paced.rate[0]))
        self._arm_offset = arm[0][0] - near[1]
        parts = zip(planned, arm, strict=True)
        joined = (np.hstack([rows[1:-1, PLATFORM_COLUMNS], joints]) for rows, joints in parts)
        return Window(times, *joined), tool[1]

    def offset(self, planned: Window) -> Window:
        """Return a planned motion (k, 9) whose arm keeps the correction of the last stretch."""
        positions = planned.positions.copy()
        positions[:, JOINT_COLUMNS] += self._arm_offset
        return replace(planned, positions=positions)


def _spacing(times: Array) -> float:
    """Return the spacing of equally spaced times (k,), a multiple of a tick [s]."""
    return max(round(float(times[1] - times[0]) / TICK), 1) * TICK
