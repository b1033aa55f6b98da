"""Drives of the MPC planner through a scene on the slipping plant, and their figures."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.closed_loop import MotionRecord, StudyError
from omniman_ros.lab.studies.mpc_cases import MpcCase
from omniman_ros.lab.studies.mpc_loop import LoopOptions, MpcLoop, MpcSceneCycle
from omniman_ros.lab.studies.scene_geometry import (
    MovingObstacle,
    RectangularOutline,
    WallRectangle,
    ellipse_gaps,
    wall_gap,
)
from omniman_ros.lab.studies.worlds import scene_world
from omniman_ros.planning.cases import Pose
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.parameters import Arrival, PlannerParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters

RECORDING_TAIL = 2.0  #: time for which a drive is recorded after the planner has finished [s]
SETTLING_TIME = 0.5  #: time after the arrival for which consumed energy still counts [s]
REST_SPEED = 0.02  #: speed below which the robot rests, the same as in the planner [m/s, rad/s]


@dataclass(frozen=True)
class RecordedDrive:
    """A recorded drive to a goal, with a row for each of K ticks of 5 ms."""

    times: Array  #: (K,) times since the goal was sent [s]
    poses: Array  #: (K, 3) true poses in odom [m, m, rad]
    odometry: Array  #: (K, 3) poses by odometry [m, m, rad]
    twists: Array  #: (K, 3) twists in base_link, from the encoders [m/s, m/s, rad/s]
    energy: Array  #: (K,) electric energy consumed since the goal was sent, less that fed back [J]
    goal: Pose  #: pose of the goal in odom [m, m, rad]
    tolerance: Arrival  #: largest errors of position and heading with which the robot has arrived
    gaps: Array  #: (K, M) true gaps to the obstacles, and then to the nearest wall if any [m]

    @staticmethod
    def of(
        record: MotionRecord,
        since: float,
        goal: Pose,
        tolerance: Arrival,
        box: RectangularOutline,
        obstacles: Sequence[MovingObstacle] = (),
        walls: Sequence[WallRectangle] = (),
    ) -> "RecordedDrive":
        """Return the drive that a motion record contains from a time on.

        Between two ticks of 5 ms, a gap may be smaller by at most half of the relative travel:
        4 mm at 1.6 m/s.
        """
        rows = slice(int(np.searchsorted(record.times, since - 1e-9)), None)
        times, poses = np.array(record.times[rows]), np.array(record.poses[rows])
        energy = np.array(record.energy[rows])
        columns = []
        for each in obstacles:
            centers = np.array([[each.place(time)] for time in times.tolist()])
            axes, angle = np.array([each.semi_axes]), np.array([each.angle])
            columns.append(ellipse_gaps(poses, box, centers, axes, angle)[:, 0])
        if walls:
            columns.append(np.min([wall_gap(poses, box, wall.row) for wall in walls], axis=0))
        return RecordedDrive(
            times - since,
            poses,
            np.array(record.odometry[rows]),
            np.array(record.twists[rows]),
            energy - energy[0],
            goal,
            tolerance,
            np.column_stack(columns) if columns else np.zeros((len(times), 0)),
        )

    @property
    def arrival(self) -> float:
        """Time at which the robot comes to rest at the goal for good [s]; inf if it never does.

        Like in the planner, odometry and encoders decide.
        """
        error = self.odometry - self.goal
        there = np.hypot(error[:, 0], error[:, 1]) <= self.tolerance.position
        angles = (error[:, 2] + math.pi) % math.tau - math.pi
        there &= np.abs(angles) <= self.tolerance.heading
        outside = np.flatnonzero(~there)
        first = int(outside[-1]) + 1 if len(outside) else 0
        rests = np.flatnonzero(np.abs(self.twists[first:]).max(axis=1, initial=0.0) < REST_SPEED)
        return float(self.times[first + rests[0]]) if len(rests) else math.inf

    @property
    def clearance(self) -> float:
        """Smallest true gap to any obstacle or wall [m]; inf if there is none."""
        return float(self.gaps.min(initial=math.inf))

    @property
    def collided(self) -> bool:
        """Whether the robot truly touched an obstacle or a wall; a gap that is NaN counts."""
        return not self.clearance > 0.0

    def energy_until_rest(self) -> float:
        """Return the energy consumed until `SETTLING_TIME` after the arrival [J]."""
        end = self.arrival + SETTLING_TIME
        if not end <= self.times[-1] + 1e-6:
            raise StudyError(
                f"the energy until rest is unknown: arrival {self.arrival:.2f} s, recorded until "
                f"{self.times[-1]:.2f} s"
            )
        return float(np.interp(end, self.times, self.energy))


@dataclass(frozen=True)
class PlannedDrive:
    """A drive with the MPC planner."""

    drive: RecordedDrive  #: recorded drive of the robot
    cycles: list[MpcSceneCycle]  #: record of the planner's cycles
    state: PlannerState  #: state of the planner when it finished
    since: float  #: time at which the goal was sent, on the clock of loop, plans and obstacles [s]
    touched: tuple[str, ...] = ()  #: what the robot touched according to the physics world

    @property
    def collided(self) -> bool:
        """Whether the robot touched anything, by the true gaps or by the physics world."""
        return self.drive.collided or bool(self.touched)

    def figures(self) -> dict[str, Any]:
        """Return the figures of the drive for a result; their units are in their names."""
        drive, planned = self.drive, [self.cycles[i] for i in self.planning]
        cpu_times = [1e3 * each.planning_time for each in self.cycles if each.planning_time > 0.0]
        error = drive.poses[-1] - drive.goal
        tracking = np.array([each.pose - each.reference for each in planned]).reshape(-1, 3)
        reached = math.isfinite(drive.arrival)
        return {
            "reached": reached,
            "collided": self.collided,
            "touched": list(self.touched),
            "state": self.state.value,
            "time_s": drive.arrival,
            "energy_j": drive.energy_until_rest() if reached else math.nan,
            "clearance_m": drive.clearance,
            "off_m": float(np.hypot(error[0], error[1])),
            "off_rad": float(abs(se2.wrap(error[2]))),
            "tracking_m": float(np.hypot(*tracking[:, :2].T).max(initial=0.0)),
            "cycles": len(planned),
            "plans_used": sum(each.report.used for each in planned),
            "brakings": sum(each.report.braking for each in planned),
            "cpu_median_ms": float(np.median(cpu_times)) if cpu_times else math.nan,
            "cpu_p99_ms": float(np.percentile(cpu_times, 99)) if cpu_times else math.nan,
        }

    @property
    def planning(self) -> list[int]:
        """Cycles in which the planner planned: driving or blocked, and that of its arrival."""
        planning_states = (PlannerState.DRIVING, PlannerState.BLOCKED)
        rows = [i for i, each in enumerate(self.cycles) if each.state in planning_states]
        final = rows[-1] + 1 if rows else 0
        return rows + ([final] if 0 < final < len(self.cycles) else [])


def drive_with_planner(
    robot: Mapping[str, Any],
    scene: MpcCase,
    changes: Mapping[str, Any],
    voltages: bool,
    seed: int,
    timer: Callable[[], float],
    wheels: str | None,
) -> PlannedDrive:
    """Drive through a scene with the planner until it arrives, is blocked or runs out of time.

    Being blocked ends the drive only if all obstacles are at rest and there is no map.

    Args:
        changes: Changed parameters of the planner, full names to values.
        voltages: Whether the planner's motor voltages are applied, MPC 2021 (20), instead of its
            reference being followed.
        wheels: Kind of wheels in the physics world; None for the plant.
    """
    parameters = build(PlannerParameters, {**robot, **changes})
    world = (
        scene_world(robot, wheels, scene.start, scene.obstacles, scene.walls) if wheels else None
    )
    options = LoopOptions(scene.start, scene.obstacles, voltages, scene.noise, seed, timer, world)
    simulation = build(SimulationParameters, {})
    loop = MpcLoop(parameters, build(PlatformParameters, robot), simulation, options)
    loop.planner.set_map(scene.grid)
    since = loop.now
    loop.drive(PoseGoal(np.array(scene.goal)))
    final_states = (PlannerState.ARRIVED, PlannerState.BLOCKED)
    # With a map, the search for another route may still succeed; where obstacles move, the way of
    # a blocked robot may become free again.
    unchanging = scene.grid is None and all(each.is_fixed for each in scene.obstacles)
    end_states = final_states if unchanging else final_states[:1]
    loop.run(scene.time_limit, until=lambda: loop.planner.state in end_states)
    state = loop.planner.state
    loop.run(RECORDING_TAIL)
    body = parameters.robot.body
    drive = RecordedDrive.of(
        loop.motion_record,
        since,
        scene.goal,
        parameters.arrival,
        RectangularOutline(body.length, body.width),
        scene.obstacles,
        scene.walls,
    )
    return PlannedDrive(drive, loop.cycles, state, since, tuple(loop.touched))
