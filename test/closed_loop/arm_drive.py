"""Drives with the arm stretched to the left in the physics world."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.parameters import build
from omniman_ros.description.arm_mass import ArmMass
from omniman_ros.lab.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.world.parameters import IDEAL

LEFT = (math.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0)
POSTURE_TICKS = 8  #: Number of ticks between two postures that the controller gets


@dataclass(frozen=True)
class Figures:
    """What a drive showed; units are N, s, m, rad and rad/s."""

    speed_error: float
    yaw_error: float
    least_load: float
    lifted: float
    tilt: float
    stop_way: float


def drive(robot, twists, seconds, *, knows_posture):
    """Drive twists one after another, each for some seconds, and stop.

    `knows_posture` is whether the controller knows the arm's posture, and limits itself to what it
    bears; else the arm is a mass at a fixed place.
    """
    parameters = build(PlatformParameters, {**robot, "stability.limit": knows_posture})
    choice = WorldChoice.of(robot, IDEAL)
    loop = ClosedLoop(parameters, build(SimulationParameters, robot), world=choice)
    core, world = loop.controller, loop.world
    world.arm.place(LEFT)
    mass = ArmMass(choice.description.robot.arm, choice.description.mount)
    errors, yaw_errors, loads, tilts = [], [], [], []

    def watch(duration, twist):
        for _ in range(round(duration / PERIOD)):
            if knows_posture and loop.tick % POSTURE_TICKS == 0:
                core.set_arm(mass.at(world.arm.positions))
            if twist is not None:
                core.set_twist(np.array(twist), loop.now)
            loop.step()
            errors.append(core.cascade.reference - [wheel.speed for wheel in world.wheels])
            yaw_errors.append(float(core.setpoint[2] - world.twist[2]))
            loads.append(float(world.wheel_loads.min()))
            tilts.append(math.acos(min(1.0, float(world.base_frame[1][2, 2]))))

    watch(0.5, None)  # it comes to rest on its tyres
    for seen in (errors, yaw_errors, loads, tilts):
        seen.clear()
    for twist in twists:
        watch(seconds, twist)
    assert core.latch.released, core.latch.status.reason
    start = world.pose
    core.latch.stop("end of the drive")
    watch(1.5, None)
    return Figures(
        speed_error=float(np.sqrt(np.mean(np.square(errors)))),
        yaw_error=float(np.sqrt(np.mean(np.square(yaw_errors)))),
        least_load=min(loads),
        lifted=PERIOD * sum(load <= 0.0 for load in loads),
        tilt=max(tilts),
        stop_way=math.dist(world.pose[:2], start[:2]),
    )
