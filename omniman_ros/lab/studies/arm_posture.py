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
SETTLING_TIME = 0.5
"""Time before the first twist, in which the robot comes to rest on its tyres [s]."""
STOP_TIME = 1.5
"""Time for which the last stop is watched [s]."""


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


def drive(
    robot: Mapping[str, Any],
    twists: Sequence[Sequence[float]],
    seconds: float,
    *,
    knows_posture: bool,
) -> Figures:
    """Drive twists one after another with the arm stretched to the left, and stop.

    Args:
        robot: Parameters of a robot with an arm, full names to values.
        twists: Twists (k, 3) of `cmd_vel` [m/s, m/s, rad/s].
        seconds: Duration of each [s].
        knows_posture: Whether the controller knows the arm's posture, and limits itself to what it
            bears; else the arm is a mass at a fixed place.

    Raises:
        CommandError: The controller stopped.
    """
    parameters = build(PlatformParameters, {**robot, "stability.limit": knows_posture})
    choice = WorldChoice.of(robot, IDEAL)
    loop = ClosedLoop(parameters, build(SimulationParameters, robot), world=choice)
    core, world = loop.controller, loop.world
    assert world is not None and world.arm is not None  # as chosen, and by the arm's mass
    world.arm.place(LEFT)
    if knows_posture:
        description = choice.description
        core.set_arm(ArmMass(description.robot.arm, description.mount).at(np.array(LEFT)))
    errors: list[Array] = []
    yaw_errors, loads, tilts = [], [], []

    def watch(duration: float, twist: Sequence[float] | None) -> None:
        for _ in range(round(duration / PERIOD)):
            if twist is not None:
                core.set_twist(np.array(twist, dtype=float), loop.now)
            loop.step()
            errors.append(core.cascade.reference - [wheel.speed for wheel in world.wheels])
            yaw_errors.append(core.setpoint[2] - world.twist[2])
            loads.append(float(world.wheel_loads.min()))
            tilts.append(math.acos(min(1.0, float(world.base_frame[1][2, 2]))))

    watch(SETTLING_TIME, None)
    for seen in (errors, yaw_errors, loads, tilts):
        seen.clear()
    for twist in twists:
        watch(seconds, twist)
    if not core.latch.released:
        raise CommandError(f"the controller stopped: {core.latch.status.reason}")
    speed, start = math.hypot(*world.twist[:2]), world.pose
    core.latch.stop("end of the drive")
    watch(STOP_TIME, None)
    return Figures(
        speed_error=_rms(errors),
        yaw_error=_rms(yaw_errors),
        least_load=min(loads),
        lifted=PERIOD * sum(load <= 0.0 for load in loads),
        tilt=max(tilts),
        speed=speed,
        stop_way=math.dist(world.pose[:2], start[:2]),
        share=core.stability.share,
    )


def _rms(values: Sequence[Array] | Sequence[float]) -> float:
    """Return the root of the mean square of numbers."""
    return float(np.sqrt(np.mean(np.square(values))))
