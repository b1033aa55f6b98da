"""The arm takes the platform's tracking error out of the tool's pose.

Source: CCTA 2017 V.A, platform and arm on one time base. The platform is off its reference by
some millimetres, and by milliradians that the arm's reach turns into millimetres. The arm's
angles are therefore those with which the tool is where it is to be from where the platform will
be: its reference plus its error, filtered and carried on over the time that passes from a
measurement until the arm has moved.
"""

import math

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible, se2
from omniman_ros.core.body.model import BodyModel
from omniman_ros.core.body.parameters import ToolPathOptions
from omniman_ros.core.errors import InputError

Array = NDArray[np.float64]

FADING = 0.3
"""How long a rate of the error goes on [s]: the platform's own control takes it back."""
LONGEST_GAP = 0.25
"""After so long without a measurement the filter begins anew [s]."""
SLOWEST = 0.1
"""The least pace from which joint speeds at another are concluded."""
BELIEVED = 3
"""So many measurements one after the other that are too far off are no mistake of one."""
FREE = 0.5
"""Share of the largest error up to which the motion is not slowed."""


class PlatformCorrection:
    """The platform's tracking error in odom, from its measured poses.

    An alpha-beta filter with both poles in one place: it follows an error that changes at a
    constant rate without lag. T. R. Benedict and G. W. Bordner, "Synthesis of an optimal set of
    radar track-while-scan smoothing equations" (1962), for its kind.

    Args:
        options: How much is corrected, and how the error is filtered; may be replaced at any time.

    Attributes:
        options: As above.
        error: (3,) measured less reference, filtered, at the last measurement [m, m, rad].
        rate: (3,) of the error [m/s, m/s, rad/s].
        time: Of the last measurement [s]; minus infinity before the first.
    """

    def __init__(self, options: ToolPathOptions) -> None:
        self.options = options
        self.error: Array = np.zeros(3)
        self.rate: Array = np.zeros(3)
        self.time = -math.inf
        self._strange = 0

    def hear(self, time: float, measured: Array, reference: Array) -> None:
        """Take in a measured pose.

        Args:
            time: When it was measured [s].
            measured: (3,) pose of base_link in odom [m, m, rad]; any whole turns.
            reference: (3,) where it was to be at that time [m, m, rad].

        Raises:
            InputError: Not finite, not newer than the last, or further off than is corrected, but
                not yet so often that it is believed; the error is not changed.
        """
        if not time > self.time:
            raise InputError(f"a pose of {time:.3f} s, the last was of {self.time:.3f} s")
        plausible.demand(measured[:2], plausible.LENGTH, "position")
        plausible.demand(measured[2:], plausible.ANGLE, "heading")
        raw = measured - reference
        raw[2] = se2.wrap(float(raw[2]))
        step = time - self.time
        self.time = time
        if float(self._shares(raw[None])[0]) > 1.0:
            self._strange += 1
            if self._strange < BELIEVED:
                raise InputError(
                    f"the platform would be {math.hypot(raw[0], raw[1]):.3f} m and "
                    f"{raw[2]:.3f} rad off its path"
                )
            self.error, self.rate = raw, np.zeros(3)
            return
        self._strange = 0
        if step > LONGEST_GAP:
            self.error, self.rate = raw, np.zeros(3)
            return
        keep = math.exp(-self.options.correction_bandwidth * step)
        expected = self.error + step * self.rate
        off = raw - expected
        self.error = expected + (1.0 - keep * keep) * off
        self.rate = self.rate + (1.0 - keep) ** 2 / step * off

    def error_at(self, times: Array) -> Array:
        """Errors (k, 3) [m, m, rad] that are expected at times (k,) [s], within the bounds.

        The rate fades. Before the last measurement it is that one's; where correction is off, and
        before the first, there is none.
        """
        if not self.options.correction or math.isinf(self.time):
            return np.zeros((len(times), 3))
        since = np.maximum(times - self.time, 0.0)
        ahead = -FADING * np.expm1(-since / FADING)
        expected: Array = self.error + ahead[:, None] * self.rate
        return expected / np.maximum(self._shares(expected), 1.0)[:, None]

    def platform_at(self, reference: Array, times: Array) -> Array:
        """Poses (k, 3) [m, m, rad] that the platform is expected to have.

        Args:
            reference: (k, 3) where it is to be [m, m, rad].
            times: (k,) [s].
        """
        result: Array = reference + self.error_at(times)
        return result

    @property
    def share(self) -> float:
        """The error over the largest that is corrected; the motion is given up above 1."""
        return float(self._shares(self.error[None])[0])

    def pace(self) -> float:
        """How fast the motion may go on its path, 0 to 1: slower as the error nears its bound."""
        return min(max((1.0 - self.share) / (1.0 - FREE), 0.0), 1.0)

    def _shares(self, errors: Array) -> Array:
        """Errors (k, 3) over their bounds, the larger of distance and heading (k,)."""
        distance = np.hypot(errors[:, 0], errors[:, 1]) / self.options.max_error
        turn = np.abs(errors[:, 2]) / self.options.max_heading_error
        return np.maximum(distance, turn)


def arm_motion(
    model: BodyModel, platform: Array, tool: Array, branch: int, near: Array, step: float
) -> tuple[Array, Array, Array]:
    """Joint angles, rates and second derivatives, each (k, 6), with which the tool is on its way.

    The derivatives are central differences: what slows the motion is in them.

    Args:
        model: Of the robot.
        platform: (k + 2, 3) poses of base_link [m, m, rad], a step before the first to a step
            after the last.
        tool: (k + 2, 4, 4) poses of `tool0` in odom at the same times.
        branch: Of the arm, :meth:`ArmModel.inverse`.
        near: (k + 2, 6) planned angles [rad]; each result is within half a turn of them.
        step: Between two of them [s].

    Raises:
        InputError: The tool cannot be reached from there.
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
    bend = (q[2:] - 2.0 * q[1:-1] + q[:-2]) / (step * step)
    return q[1:-1], rate, bend


def speed_pace(velocities: Array, limits: Array, pace: float = 1.0) -> float:
    """The pace, 0 to 1, at which no joint is too fast.

    Args:
        velocities: (k, n) predicted at the present pace [rad/s].
        limits: (n,) largest [rad/s].
        pace: The present one, 0 to 1.
    """
    used = float((np.abs(velocities) / limits).max(initial=0.0))
    held = max(pace, SLOWEST)  # what stands tells nothing of full speed
    return min(held / max(used, 1e-9), 1.0)
