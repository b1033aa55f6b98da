"""Comparison of the energies of planner and kinematic controller at equal arrival times."""

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
from omniman_ros.lab.studies.mpc_loop import MotionRecord
from omniman_ros.lab.studies.planned_drives import RECORDING_TAIL, drive_with_planner
from omniman_ros.lab.studies.recorded_drive import Drive, StudyError
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.motion.path.parameters import TICK, PathParameters
from omniman_ros.motion.path.trajectory import Trajectory
from omniman_ros.planning.cases import Pose
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters

ARRIVAL_TIME_TOLERANCE = 0.02
"""Largest difference of arrival times that count as equal [s]."""
MAX_DRIVES = 12
"""Largest number of drives in the search for the speed that gives the requested arrival time."""


@dataclass(frozen=True)
class KinematicDrive:
    """A drive along the straight line from start to goal, with path planner and controller.

    Attributes:
        drive: Recorded drive of the robot.
        speed: Largest speed along the path [m/s].
        limit_scale: Factor on the limits of speed and acceleration that the path keeps.
    """

    drive: Drive
    speed: float
    limit_scale: float


def drive_straight(
    robot: Mapping[str, Any],
    start: Pose,
    goal: Pose,
    speed: float,
    limit_scale: float = 1.0,
    wheels: str | None = None,
) -> KinematicDrive:
    """Drive a straight line with path planner and platform controller, without a dynamic model.

    Args:
        robot: Parameters of the robot, full names to values.
        start: Pose of the start in odom [m, m, rad].
        goal: Pose of the goal in odom [m, m, rad].
        speed: Largest speed [m/s].
        limit_scale: Factor on all limits of the path planner.
        wheels: Kind of wheels in the physics world; None for the plant.
    """
    options = {**robot, "path.linear_velocity": speed, "path.angular_velocity": 50.0}
    planner = build(PathParameters, options).planner().slower(limit_scale)
    plan = planner.plan(np.array([start, goal]))
    world = WorldChoice.of(robot, wheels) if wheels else None
    simulation = build(SimulationParameters, {})
    loop = ClosedLoop(build(PlatformParameters, robot), simulation, world=world)
    loop.drives.set_pose(start)
    loop.controller.set_pose(start)
    for _ in range(4):
        loop.step()
    since, record = loop.now, MotionRecord()
    path = Trajectory(since, TICK, plan.ticks, planner.smoother)
    times = since + TICK * np.arange(len(path.positions), dtype=float)
    preview = Preview(times, path.positions, path.velocities, path.accelerations)
    loop.controller.set_preview(Source.PATH, preview, since)
    half = PlanningModel.of(build(Robot, robot)).half
    tolerance = build(PlannerParameters, robot).arrival
    while loop.now < path.end + RECORDING_TAIL:  # meanwhile, feedback removes the remaining error
        loop.step()
        record.add(loop)
    drive = Drive.of(record, since, goal, tolerance, half)
    return KinematicDrive(drive, speed, limit_scale)


def drive_straight_in_time(
    robot: Mapping[str, Any],
    start: Pose,
    goal: Pose,
    arrival: float,
    scale_all: bool = False,
    wheels: str | None = None,
) -> KinematicDrive | None:
    """Drive a straight line with the kinematic controller so that it arrives at a given time.

    The speed that gives this arrival time is found by repeated drives.

    Args:
        robot: Parameters of the robot, full names to values.
        start: Pose of the start in odom [m, m, rad].
        goal: Pose of the goal in odom [m, m, rad].
        arrival: Requested arrival time since the start [s].
        scale_all: Whether all limits are scaled, instead of the speed alone.
        wheels: Kind of wheels in the physics world; None for the plant.

    Returns:
        The drive with the requested arrival time; None if the controller cannot be that fast.

    Raises:
        StudyError: No speed was found that gives the requested arrival time.
    """
    parameters = build(PathParameters, robot)
    fastest = (1.0 - parameters.path.reserve) * parameters.limits.linear_velocity

    def drive_scaled(scale: float) -> KinematicDrive:
        """Drive at a fraction of the largest speed or of all limits."""
        if scale_all:
            return drive_straight(robot, start, goal, fastest, scale, wheels)
        return drive_straight(robot, start, goal, scale * fastest, wheels=wheels)

    best = drive_scaled(1.0)
    # Pairs of scale and arrival time that bracket the requested time: too early and too late.
    first, last = (1.0, best.drive.arrival), (0.0, math.inf)
    if first[1] > arrival + ARRIVAL_TIME_TOLERANCE:
        return None
    for trial in range(MAX_DRIVES):
        if abs(best.drive.arrival - arrival) <= ARRIVAL_TIME_TOLERANCE:
            return best
        if math.isfinite(last[1]) and trial % 3 < 2:
            # Interpolate the inverse of the scale, to which the time is about proportional.
            part = (arrival - first[1]) / (last[1] - first[1])
            scale = 1.0 / (1.0 / first[0] + part * (1.0 / last[0] - 1.0 / first[0]))
        elif math.isfinite(last[1]):
            scale = 0.5 * (first[0] + last[0])
        else:
            scale = max(first[0] * (first[1] / arrival) ** 2, 0.3 * first[0] + 0.7 * last[0])
        best = drive_scaled(scale)
        here = scale, best.drive.arrival
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
        peak: Largest rotation in the planner's drive away from the initial heading [rad].
        speed_only: Energy of the kinematic drive whose speed alone is scaled [J]; NaN if it cannot
            be that fast.
        all_limits: Energy of the kinematic drive whose limits are all scaled [J]; NaN if it cannot
            be that fast, or if there was no such drive.
        lateness: Largest magnitude of the difference between the arrival times [s].
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
        """Ratio of the planner's energy to the lower energy of the kinematic drives."""
        lower = min(self.speed_only, self.all_limits, key=lambda e: (math.isnan(e), e))
        return self.energy / lower


def compare(
    robot: Mapping[str, Any],
    distance: float,
    bearing: float,
    changes: Mapping[str, Any],
    both: bool = True,
    wheels: str | None = None,
) -> Comparison:
    """Drive to one goal with the planner and with the kinematic controller, and compare them.

    The headings of start and goal are 0.

    Args:
        robot: Parameters of the robot, full names to values.
        distance: Distance of the goal [m].
        bearing: Bearing of the goal [rad].
        changes: Parameters of the planner that differ from the robot's, full names to values.
        both: Whether the line is also driven with all limits scaled, besides the speed alone.
        wheels: Kind of wheels in the physics world; None for the plant.

    Raises:
        StudyError: One of the two does not arrive, or not at the same time as the other.
    """
    goal = (distance * math.cos(bearing), distance * math.sin(bearing), 0.0)
    drive = drive_with_planner(robot, Scene("free", goal, changes=changes), wheels=wheels).drive
    if not math.isfinite(drive.arrival):
        raise StudyError(f"the planner did not arrive ({distance:g} m, {bearing:.2f} rad)")
    start = (0.0, 0.0, 0.0)
    variants = (False, True) if both else (False,)
    kinematic = [
        drive_straight_in_time(robot, start, goal, drive.arrival, scale_all, wheels)
        for scale_all in variants
    ]
    rides = [other.drive for other in kinematic if other is not None]
    energies = [
        math.nan if other is None else other.drive.energy_until_rest() for other in kinematic
    ]
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
