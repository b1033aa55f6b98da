"""Drives with the arm stretched in the physics world: tracking, wheel loads, lifted wheels."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.description.arm_mass import ArmMass
from omniman_ros.lab.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.world.parameters import IDEAL

LEFT = (math.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Posture with the arm stretched to the left [rad]."""
FOLDED = (math.pi / 2, -2.6, 2.6, 0.0, 0.0, 0.0)
"""Posture with the arm folded above its base, from which it stretches to the left [rad]."""
SETTLING_TIME = 0.5
"""Time before the first twist, in which the robot comes to rest on its tyres [s]."""
STOP_TIME = 1.5
"""Time for which the last stop is watched [s]."""
POSTURE_TICKS = 8
"""Number of ticks between two postures that the controller gets."""


@dataclass(frozen=True)
class Figures:
    """What a drive with the arm stretched showed.

    Attributes:
        speed_error: RMS over wheels and time of commanded minus true wheel speed [rad/s].
        yaw_error: RMS of commanded minus true yaw rate [rad/s].
        least_load: Smallest load of a wheel [N].
        lifted: Time for which at least one wheel was in the air [s].
        tilt: Largest angle between the platform's vertical and the true one [rad].
        speed: Linear speed at the beginning of the last stop [m/s].
        stop_way: Way of the last stop [m].
        share: Share of the limits of acceleration that the controller kept [-].
    """

    speed_error: float
    yaw_error: float
    least_load: float
    lifted: float
    tilt: float
    speed: float
    stop_way: float
    share: float


@dataclass(frozen=True)
class Swing:
    """The arm stretches from folded to the left after the last twist, which goes on meanwhile.

    Attributes:
        duration: Duration of the swing [s].
        stop: Time of the stop after its beginning [s].
    """

    duration: float
    stop: float

    def posture(self, time: float) -> Array:
        """Return the posture (6,) at a time after the beginning [s]; angles [rad]."""
        u = min(time / self.duration, 1.0)
        folded, left = np.array(FOLDED), np.array(LEFT)
        result: Array = folded + u * u * (3.0 - 2.0 * u) * (left - folded)
        return result


class ArmDrive:
    """A robot in the physics world, its arm, and what is seen of them.

    Args:
        robot: Parameters of a robot with an arm, full names to values.
        posture: Posture of the arm at first [rad].
        knows_posture: Whether the controller knows the arm's posture, and limits itself to what it
            bears; else the arm is a mass at a fixed place.

    Attributes:
        loop: Controller and world.
        errors: Commanded minus true wheel speeds (n,) of each tick [rad/s].
        yaw_errors: Commanded minus true yaw rate [rad/s].
        loads: Smallest load of a wheel [N].
        tilts: Angle between the platform's vertical and the true one [rad].
    """

    def __init__(
        self, robot: Mapping[str, Any], posture: Sequence[float], *, knows_posture: bool
    ) -> None:
        parameters = build(PlatformParameters, {**robot, "stability.limit": knows_posture})
        choice = WorldChoice.of(robot, IDEAL)
        self.loop = ClosedLoop(parameters, build(SimulationParameters, robot), world=choice)
        assert self.loop.world is not None and self.loop.world.arm is not None
        self._world, self._arm = self.loop.world, self.loop.world.arm
        self._arm.place(posture)
        self._mass = None
        if knows_posture:
            description = choice.description
            self._mass = ArmMass(description.robot.arm, description.mount)
        self.errors: list[Array] = []
        self.yaw_errors: list[float] = []
        self.loads: list[float] = []
        self.tilts: list[float] = []
        self._swing: Swing | None = None
        self._swing_start = 0.0
        self._is_silent = False
        self.watch(SETTLING_TIME, None)
        for seen in (self.errors, self.yaw_errors, self.loads, self.tilts):
            seen.clear()

    def begin(self, swing: Swing) -> None:
        """Begin to swing the arm."""
        self._swing, self._swing_start = swing, self.loop.now

    def watch(self, duration: float, twist: Sequence[float] | None) -> None:
        """Run for a duration [s], by a twist (3,) of `cmd_vel` if there is one."""
        loop, core, world = self.loop, self.loop.controller, self._world
        for _ in range(round(duration / PERIOD)):
            if self._swing is not None:
                self._arm.command(self._swing.posture(loop.now - self._swing_start))
            if self._mass is not None and loop.tick % POSTURE_TICKS == 0:
                core.set_arm(self._mass.at(self._arm.positions))
            if twist is not None:
                core.set_twist(np.array(twist, dtype=float), loop.now)
            step = loop.step_silent if self._is_silent else loop.step
            step()
            speeds = [wheel.speed for wheel in world.wheels]
            self.errors.append(core.cascade.reference - speeds)
            self.yaw_errors.append(float(core.setpoint[2] - world.twist[2]))
            self.loads.append(float(world.wheel_loads.min()))
            self.tilts.append(math.acos(min(1.0, float(world.base_frame[1][2, 2]))))

    def stop(self, *, is_silent: bool = False) -> Figures:
        """Stop, and return what the whole drive showed.

        Args:
            is_silent: Whether the controller falls silent, so that the drives stop by themselves.

        Raises:
            CommandError: The controller has stopped by itself.
        """
        core, world = self.loop.controller, self._world
        if not core.latch.released:
            raise CommandError(f"the controller stopped: {core.latch.status.reason}")
        speed, start = math.hypot(*world.twist[:2]), world.pose
        self._is_silent = is_silent
        if not is_silent:
            core.latch.stop("end of the drive")
        self.watch(STOP_TIME, None)
        return Figures(
            speed_error=_rms(self.errors),
            yaw_error=_rms(self.yaw_errors),
            least_load=min(self.loads),
            lifted=PERIOD * sum(load <= 0.0 for load in self.loads),
            tilt=max(self.tilts),
            speed=speed,
            stop_way=math.dist(world.pose[:2], start[:2]),
            share=core.stability.share,
        )


def drive(
    robot: Mapping[str, Any],
    twists: Sequence[Sequence[float]],
    seconds: float,
    *,
    knows_posture: bool,
    swing: Swing | None = None,
    is_silent: bool = False,
) -> Figures:
    """Drive twists one after another with the arm stretched to the left, and stop.

    Args:
        robot: Parameters of a robot with an arm, full names to values.
        twists: Twists (k, 3) of `cmd_vel` [m/s, m/s, rad/s].
        seconds: Duration of each [s].
        knows_posture: See :class:`ArmDrive`.
        swing: How the arm stretches after the twists; None if it is stretched from the beginning.
        is_silent: Whether the controller falls silent at the end, so that the drives stop.

    Raises:
        CommandError: The controller has stopped by itself.
    """
    made = ArmDrive(robot, FOLDED if swing else LEFT, knows_posture=knows_posture)
    for twist in twists:
        made.watch(seconds, twist)
    if swing is not None:
        made.begin(swing)
        made.watch(swing.stop, twists[-1])
    return made.stop(is_silent=is_silent)


def _rms(values: Sequence[Array] | Sequence[float]) -> float:
    """Return the root of the mean square of numbers."""
    return float(np.sqrt(np.mean(np.square(values))))
