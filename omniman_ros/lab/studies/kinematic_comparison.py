"""The planner compared with a kinematic controller at equal arrival times."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.arbiter import Source
from omniman_ros.core.parameters import build
from omniman_ros.core.preview import Preview
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.closed_loop import ClosedLoop
from omniman_ros.lab.studies.mpc_cases import Scene
from omniman_ros.lab.studies.mpc_loop import Course
from omniman_ros.lab.studies.planned_drives import WATCHED, drive_with_planner
from omniman_ros.lab.studies.recorded_drive import Drive, StudyError
from omniman_ros.motion.path.parameters import TICK, PathParameters
from omniman_ros.motion.path.trajectory import Trajectory
from omniman_ros.planning.cases import Pose
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters

SAME_TIME = 0.02
"""Difference up to which arrival times count as equal [s]."""
TRIALS = 12
"""Most drives in the search for the speed at which the kinematic controller arrives in time."""


@dataclass(frozen=True)
class KinematicDrive:
    """A drive along the straight line that the path planner makes of start and goal.

    Attributes:
        drive: What the robot did.
        speed: Largest speed of the path [m/s].
        limit_scale: Factor of the limits on speed and acceleration that the path keeps.
    """

    drive: Drive
    speed: float
    limit_scale: float


def drive_straight(
    robot: Mapping[str, Any], start: Pose, goal: Pose, speed: float, limit_scale: float = 1.0
) -> KinematicDrive:
    """Drive a straight line with path planner and platform controller, which know no dynamics.

    Args:
        robot: Parameters of the robot, full names to values.
        start: Pose of the start in odom [m, m, rad].
        goal: Pose of the goal in odom [m, m, rad].
        speed: Largest speed [m/s].
        limit_scale: Factor of all limits.
    """
    options = {**robot, "path.linear_velocity": speed, "path.angular_velocity": 50.0}
    planner = build(PathParameters, options).planner().slower(limit_scale)
    plan = planner.plan(np.array([start, goal]))
    loop = ClosedLoop(build(PlatformParameters, robot), build(SimulationParameters, {}))
    loop.drives.set_pose(start)
    loop.controller.set_pose(start)
    for _ in range(4):
        loop.step()
    since, course = loop.now, Course()
    path = Trajectory(since, TICK, plan.ticks, planner.smoother)
    times = since + TICK * np.arange(len(path.positions), dtype=float)
    preview = Preview(times, path.positions, path.velocities, path.accelerations)
    loop.controller.set_preview(Source.PATH, preview, since)
    half = PlanningModel.of(build(Robot, robot)).half
    tolerance = build(PlannerParameters, robot).arrival
    while loop.now < path.end + WATCHED:  # feedback removes the remaining error
        loop.step()
        course.add(loop)
    drive = Drive.of(course, since, goal, tolerance, half)
    return KinematicDrive(drive, speed, limit_scale)


def drive_straight_in_time(
    robot: Mapping[str, Any], start: Pose, goal: Pose, arrival: float, whole: bool = False
) -> KinematicDrive | None:
    """Find the speed at which the kinematic controller arrives at a given time.

    Args:
        robot: Parameters of the robot, full names to values.
        start: Pose of the start in odom [m, m, rad].
        goal: Pose of the goal in odom [m, m, rad].
        arrival: Arrival time to meet [s].
        whole: Whether accelerations are lowered as well, instead of the speed alone.

    Returns:
        The drive that arrives then; None if the controller cannot be so fast.

    Raises:
        StudyError: No speed was found at which the controller arrives then.
    """
    parameters = build(PathParameters, robot)
    fastest = (1.0 - parameters.path.reserve) * parameters.limits.linear_velocity

    def ride(share: float) -> KinematicDrive:
        if whole:
            return drive_straight(robot, start, goal, fastest, share)
        return drive_straight(robot, start, goal, share * fastest)

    best = ride(1.0)
    first, last = (1.0, best.drive.arrival), (0.0, math.inf)
    if first[1] > arrival + SAME_TIME:
        return None
    for turn in range(TRIALS):
        if abs(best.drive.arrival - arrival) <= SAME_TIME:
            return best
        if math.isfinite(last[1]) and turn % 3 < 2:  # the time is about inverse to the scale
            part = (arrival - first[1]) / (last[1] - first[1])
            share = 1.0 / (1.0 / first[0] + part * (1.0 / last[0] - 1.0 / first[0]))
        elif math.isfinite(last[1]):
            share = 0.5 * (first[0] + last[0])
        else:
            share = max(first[0] * (first[1] / arrival) ** 2, 0.3 * first[0] + 0.7 * last[0])
        best = ride(share)
        here = share, best.drive.arrival
        first, last = (here, last) if here[1] < arrival else (first, here)
    raise StudyError(
        f"the kinematic controller does not arrive at {arrival:.2f} s, "
        f"but at {best.drive.arrival:.2f} s"
    )


@dataclass(frozen=True)
class Comparison:
    """Planner and kinematic controller, compared from start to goal at equal arrival times.

    Attributes:
        distance: Distance of the goal from the start [m].
        bearing: Bearing of the goal from the start [rad].
        arrival: Arrival time of the planner [s].
        energy: Energy that the planner's drive consumes [J].
        peak: Largest turn of the planner's drive away from the heading of start and goal [rad].
        speed_only: Energy of the kinematic controller that is slowed down by its speed alone [J];
            NaN where it cannot be so fast.
        all_limits: Energy of the kinematic controller that is slowed down by all its limits [J];
            NaN where it cannot be so fast, or was not driven.
        lateness: Largest difference of the arrival times [s].
    """

    distance: float
    bearing: float
    arrival: float
    energy: float
    peak: float
    speed_only: float
    all_limits: float
    lateness: float

    @property
    def ratio(self) -> float:
        """The planner's energy over that of the better kinematic controller."""
        better = min(self.speed_only, self.all_limits, key=lambda e: (math.isnan(e), e))
        return self.energy / better


def compare(
    robot: Mapping[str, Any],
    distance: float,
    bearing: float,
    changes: Mapping[str, Any],
    both: bool = True,
) -> Comparison:
    """Drive to one goal with both, where the headings of start and goal are 0.

    Args:
        robot: Parameters of the robot, full names to values.
        distance: Distance of the goal [m].
        bearing: Bearing of the goal [rad].
        changes: Parameters of the planner that differ from the robot's, full names to values.
        both: Whether the line is also driven with all limits lowered, besides the speed alone.

    Raises:
        StudyError: One of the two does not arrive, or not at the same time.
    """
    goal = (distance * math.cos(bearing), distance * math.sin(bearing), 0.0)
    drive = drive_with_planner(robot, Scene("free", goal, changes=changes)).drive
    if not math.isfinite(drive.arrival):
        raise StudyError(f"the planner did not arrive ({distance:g} m, {bearing:.2f} rad)")
    start = (0.0, 0.0, 0.0)
    variants = (False, True) if both else (False,)
    others = [
        drive_straight_in_time(robot, start, goal, drive.arrival, whole) for whole in variants
    ]
    rides = [other.drive for other in others if other is not None]
    energies = [math.nan if other is None else other.drive.energy_until_rest() for other in others]
    energies += [math.nan] * (2 - len(energies))
    return Comparison(
        distance,
        bearing,
        drive.arrival,
        drive.energy_until_rest(),
        float(np.abs(drive.poses[:, 2]).max()),
        energies[0],
        energies[1],
        max((abs(ride.arrival - drive.arrival) for ride in rides), default=math.nan),
    )
