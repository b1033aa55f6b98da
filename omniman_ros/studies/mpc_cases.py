"""The test cases of MPC 2021, section 4, driven on the slipping plant and judged by the truth.

The scenes are those of `planning.cases`.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.core.arbiter import Source
from omniman_ros.core.errors import OmnimanError
from omniman_ros.core.parameters import build
from omniman_ros.core.path.parameters import TICK, PathParameters
from omniman_ros.core.path.trajectory import Trajectory
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.core.preview import Preview
from omniman_ros.core.robot import Robot
from omniman_ros.drive.parameters import SimulationParameters
from omniman_ros.planning import economy
from omniman_ros.planning.cases import CASES, RADIUS, Case, Pose
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.grid_map import GridMap
from omniman_ros.planning.model import PlanningModel
from omniman_ros.planning.parameters import Arrival, PlannerParameters
from omniman_ros.planning.separation import box_gap
from omniman_ros.studies.closed_loop import ClosedLoop
from omniman_ros.studies.mpc_loop import Course, MovingObstacle, MpcLoop, Trace
from omniman_ros.studies.scene_geometry import Box, Wall, wall_gap

Array = NDArray[np.float64]

PAPER: Mapping[str, Any] = {"horizon.steps": 10, "horizon.step": 0.1, "weights.running": 0.0}
"""The paper's horizon and cost: n = 10 stages of 0.1 s, nothing of (31) before the end."""
SETTLE = 0.5
"""What the robot takes for so long after it has arrived counts too [s]."""
WATCHED = 2.0
"""How long the robot is watched after its planner is done: it may still come to rest [s]."""
AT_REST = 0.02
"""Speed below which the robot stands, as the planner has it [m/s, rad/s]."""
SAME_TIME = 0.02
"""Arrival times that differ by less are equal [s]."""
RIDES = 12
"""To find the speed at which the kinematic controller arrives at a time."""
MOVING = 0.1
"""Speed from which on there is a direction of travel [m/s]."""
NEAR_DIAGONAL = math.radians(10.0)
"""Up to here from a roller diagonal the robot travels along it."""


class StudyError(OmnimanError):
    """A drive cannot be compared; its figures would mean nothing."""


# ---- scenes -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scene:
    """A test case.

    Attributes:
        name: Of the case.
        goal: Pose in odom [m, m, rad].
        start: Pose in odom [m, m, rad].
        obstacles: What is there.
        snapshots: Times that are shown [s].
        changes: Full parameter names to values, where the case needs others than the defaults.
        noise: Standard deviation of observed places [m].
        most: The goal must be reached by then [s].
        walls: What stands for good.
        grid: What the robot has of them, a map.
    """

    name: str
    goal: Pose
    start: Pose = (0.0, 0.0, 0.0)
    obstacles: tuple[MovingObstacle, ...] = ()
    snapshots: tuple[float, ...] = ()
    changes: Mapping[str, Any] = field(default_factory=dict)
    noise: float = 0.0
    most: float = 30.0
    walls: tuple[Wall, ...] = ()
    grid: GridMap | None = None


def circle(radius: float, place: Callable[[float], Array]) -> MovingObstacle:
    """A circle that moves."""
    return MovingObstacle((radius, radius), place)


# ---- drives -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drive:
    """What a robot did, a row for each of K ticks of 5 ms.

    Attributes:
        times: (K,) since it was sent off [s].
        poses: (K, 3) as they truly were [m, m, rad].
        odometry: (K, 3) as the robot had them.
        twists: (K, 3) in base_link, from the encoders [m/s, m/s, rad/s].
        energy: (K,) electric energy taken since it was sent off, what is fed back taken off [J].
        goal: Pose in odom.
        tolerance: When a goal is reached.
        gaps: (K, M) true gaps to the obstacles [m], the last to the walls where there are any.
    """

    times: Array
    poses: Array
    odometry: Array
    twists: Array
    energy: Array
    goal: Pose
    tolerance: Arrival
    gaps: Array

    @staticmethod
    def of(
        course: Course,
        since: float,
        goal: Pose,
        tolerance: Arrival,
        half: Array,
        obstacles: Sequence[MovingObstacle] = (),
        walls: Sequence[Wall] = (),
    ) -> "Drive":
        """What came of a course since a time [s], among obstacles as they truly were."""
        rows = slice(int(np.searchsorted(course.times, since - 1e-9)), None)
        times, poses = np.array(course.times[rows]), np.array(course.poses[rows])
        energy = np.array(course.energy[rows])
        gaps = true_gaps(times, poses, half, obstacles)
        if walls:
            gaps = np.column_stack([gaps, wall_gaps(poses, half, walls)])
        return Drive(
            times - since, poses, np.array(course.odometry[rows]), np.array(course.twists[rows]),
            energy - energy[0], goal, tolerance, gaps,
        )  # fmt: skip

    @property
    def arrival(self) -> float:
        """When the robot first rests at the goal, not to leave it again [s]; or inf.

        By its odometry and encoders, as the planner judges it.
        """
        error = self.odometry - self.goal
        there = np.hypot(error[:, 0], error[:, 1]) <= self.tolerance.position
        there &= np.abs(_wrapped(error[:, 2])) <= self.tolerance.heading
        away = np.flatnonzero(~there)
        first = int(away[-1]) + 1 if len(away) else 0
        rests = np.flatnonzero(np.abs(self.twists[first:]).max(axis=1, initial=0.0) < AT_REST)
        return float(self.times[first + rests[0]]) if len(rests) else math.inf

    @property
    def clearance(self) -> float:
        """Least true gap to any obstacle [m]; inf without one."""
        return float(self.gaps.min(initial=math.inf))

    @property
    def collided(self) -> bool:
        """Whether the robot truly touched an obstacle."""
        return not self.clearance > 0.0

    def taken(self) -> float:
        """Energy from the start until `SETTLE` after the arrival [J].

        Raises:
            StudyError: The goal was not reached, or it was not watched for so long.
        """
        end = self.arrival + SETTLE
        if not end <= self.times[-1] + 1e-6:
            raise StudyError(f"no energy until rest: arrival {self.arrival:.2f} s, watched until "
                             f"{self.times[-1]:.2f} s")  # fmt: skip
        return float(np.interp(end, self.times, self.energy))

    def slant(self) -> tuple[Array, Array]:
        """Direction of travel as seen from the robot: times (k,) [s] and angles (k,) [rad].

        Where it is faster than `MOVING`; by the encoders.
        """
        moving = np.hypot(self.twists[:, 0], self.twists[:, 1]) > MOVING
        return self.times[moving], np.arctan2(self.twists[moving, 1], self.twists[moving, 0])


def _wrapped(angles: Array) -> Array:
    result: Array = (angles + math.pi) % math.tau - math.pi
    return result


def true_gaps(
    times: Array, poses: Array, half: Array, obstacles: Sequence[MovingObstacle]
) -> Array:
    """Gaps (K, M) [m] between the robot's box at poses (K, 3) and obstacles at times (K,) [s].

    Between two ticks of 5 ms they may be smaller by no more than half of the relative travel,
    4 mm at 1.6 m/s.
    """
    if not obstacles:
        return np.zeros((len(times), 0))
    centers = np.array([[o.place(time) for o in obstacles] for time in times.tolist()])
    axes = np.tile(np.array([o.semi_axes for o in obstacles]), (len(times), 1, 1))
    return box_gap(poses, half, centers, axes, np.array([o.angle for o in obstacles]))


def wall_gaps(poses: Array, half: Array, walls: Sequence[Wall]) -> Array:
    """Gap (K,) [m] between the robot's box at poses (K, 3) and the nearest wall."""
    box = Box(2.0 * float(half[0]), 2.0 * float(half[1]))
    rows = [np.array([wall.x, wall.y, wall.heading, wall.length, wall.width]) for wall in walls]
    count = len(poses)
    gaps = [wall_gap(poses, box, np.tile(row, (count, 1))) for row in rows]
    result: Array = np.min(gaps, axis=0)
    return result


@dataclass(frozen=True)
class Planned:
    """A drive by the planner.

    Attributes:
        drive: What the robot did.
        trace: What the planner did, its times since the robot was sent off.
        state: Of the planner at the end.
        since: Time of the loop, its plans and its obstacles at which it was sent off [s].
    """

    drive: Drive
    trace: Trace
    state: PlannerState
    since: float

    def figures(self) -> dict[str, Any]:
        """What is told of it; times [s], energies [J], gaps [m], CPU times [ms]."""
        drive, trace = self.drive, self.trace
        cycles = [i for i, spent in enumerate(trace.spent) if spent > 0.0]
        spent = 1e3 * np.array([trace.spent[i] for i in cycles])
        reports = [trace.reports[i] for i in self.planning]
        error = drive.poses[-1] - drive.goal
        reached = math.isfinite(drive.arrival)
        return {
            "reached": reached,
            "collided": drive.collided,
            "state": self.state.value,
            "time_s": drive.arrival,
            "energy_j": drive.taken() if reached else math.nan,
            "clearance_m": drive.clearance,
            "off_m": float(np.hypot(error[0], error[1])),
            "off_rad": float(abs(se2.wrap(error[2]))),
            "tracking_m": float(self.tracking().max(initial=0.0)),
            "cycles": len(reports),
            "plans_used": sum(report.used for report in reports),
            "brakings": sum(report.braking for report in reports),
            "cpu_median_ms": float(np.median(spent)) if len(spent) else math.nan,
            "cpu_p99_ms": float(np.percentile(spent, 99)) if len(spent) else math.nan,
        }

    @property
    def planning(self) -> list[int]:
        """Rows of the trace in which the planner was on its way."""
        on_its_way = (PlannerState.DRIVING, PlannerState.BLOCKED)
        rows = [i for i, state in enumerate(self.trace.states) if state in on_its_way]
        first = rows[-1] + 1 if rows else 0  # the cycle in which it arrived planned too
        return rows + ([first] if 0 < first < len(self.trace.states) else [])

    def tracking(self) -> Array:
        """How far (k,) the robot truly was from its reference [m]."""
        rows = self.planning
        off = np.array([self.trace.poses[i] - self.trace.references[i] for i in rows])
        result: Array = np.hypot(*off.reshape(-1, 3)[:, :2].T)
        return result


def planned(
    robot: Mapping[str, Any],
    scene: Scene,
    voltages: bool = False,
    seed: int = 0,
    timer: Callable[[], float] | None = None,
) -> Planned:
    """Let the planner drive a scene, until it has arrived or gives up.

    Args:
        robot: Full parameter names to values.
        scene: The scene.
        voltages: Whether motor voltages are put out, or a reference to follow.
        seed: Of the observations' noise.
        timer: CPU time [s].
    """
    values = {**robot, **scene.changes}
    parameters = build(PlannerParameters, values)
    loop = MpcLoop(
        parameters, build(PlatformParameters, robot), build(SimulationParameters, {}),
        scene.start, scene.obstacles, voltages, noise=scene.noise, seed=seed, timer=timer,
    )  # fmt: skip
    loop.planner.chart(scene.grid)
    since = loop.now
    loop.drive(PoseGoal(np.array(scene.goal)))
    given_up = (PlannerState.ARRIVED, PlannerState.BLOCKED)
    # A search for a way around may yet find one.
    standing = scene.grid is None and not any(
        np.ptp([o.place(0.0), o.place(1.0)], axis=0).any() for o in loop.obstacles
    )
    # Where obstacles move, a robot that is blocked may yet be free again.
    ends = given_up if standing else given_up[:1]
    loop.run(scene.most, until=lambda: loop.planner.state in ends)
    state = loop.planner.state
    loop.run(WATCHED, until=lambda: False)
    trace = replace(loop.trace, times=[time - since for time in loop.trace.times])
    drive = Drive.of(
        loop.course, since, scene.goal, parameters.arrival, loop.planner.model.half,
        scene.obstacles, scene.walls,
    )  # fmt: skip
    return Planned(drive, trace, state, since)


# ---- what the kinematic controller takes for the same -------------------------------------------


@dataclass(frozen=True)
class Kinematic:
    """A drive along the straight line that the path planner makes of start and goal.

    Attributes:
        drive: What the robot did.
        speed: Largest speed of the path [m/s].
        share: Of the limits on speed and acceleration that the path uses.
    """

    drive: Drive
    speed: float
    share: float


def kinematic(
    robot: Mapping[str, Any], start: Pose, goal: Pose, speed: float, share: float = 1.0
) -> Kinematic:
    """Drive a straight line by path planner and platform controller, which know no dynamics.

    Args:
        robot: Full parameter names to values.
        start, goal: Poses in odom [m, m, rad].
        speed: Largest speed [m/s].
        share: Of all limits that is used.
    """
    options = {**robot, "path.linear_velocity": speed, "path.angular_velocity": 50.0}
    planner = build(PathParameters, options).planner().slower(share)
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
    loop.controller.hear_preview(Source.PATH, preview, since)
    half = PlanningModel.of(build(Robot, robot)).half
    tolerance = build(PlannerParameters, robot).arrival
    while loop.now < path.end + WATCHED:  # feedback takes out what is left
        loop.step()
        course.add(loop)
    drive = Drive.of(course, since, goal, tolerance, half)
    return Kinematic(drive, speed, share)


def at_equal_time(
    robot: Mapping[str, Any], start: Pose, goal: Pose, arrival: float, whole: bool = False
) -> Kinematic | None:
    """The kinematic controller that arrives at a time; None if it cannot be so fast.

    Args:
        robot: Full parameter names to values.
        start, goal: Poses in odom [m, m, rad].
        arrival: When [s].
        whole: Whether accelerations are lowered too, or the speed alone.

    Raises:
        StudyError: No speed was found at which it arrives then.
    """
    parameters = build(PathParameters, robot)
    fastest = (1.0 - parameters.path.reserve) * parameters.limits.linear_velocity

    def ride(share: float) -> Kinematic:
        if whole:
            return kinematic(robot, start, goal, fastest, share)
        return kinematic(robot, start, goal, share * fastest)

    best = ride(1.0)
    first, last = (1.0, best.drive.arrival), (0.0, math.inf)
    if first[1] > arrival + SAME_TIME:
        return None
    for turn in range(RIDES):
        if abs(best.drive.arrival - arrival) <= SAME_TIME:
            return best
        if math.isfinite(last[1]) and turn % 3 < 2:  # time goes about as one over the share
            part = (arrival - first[1]) / (last[1] - first[1])
            share = 1.0 / (1.0 / first[0] + part * (1.0 / last[0] - 1.0 / first[0]))
        elif math.isfinite(last[1]):
            share = 0.5 * (first[0] + last[0])
        else:
            share = max(first[0] * (first[1] / arrival) ** 2, 0.3 * first[0] + 0.7 * last[0])
        best = ride(share)
        here = share, best.drive.arrival
        first, last = (here, last) if here[1] < arrival else (first, here)
    raise StudyError(f"the kinematic controller does not arrive at {arrival:.2f} s, "
                     f"but at {best.drive.arrival:.2f} s")  # fmt: skip


@dataclass(frozen=True)
class Comparison:
    """Planner against kinematic controller from start to goal at equal arrival time.

    Attributes:
        distance, bearing: Of the goal, as seen from the start [m, rad].
        arrival: Of the planner [s].
        energy: That it takes [J].
        peak: Most that it turned away from the heading of start and goal [rad].
        speed_only, all_limits: Energy of the kinematic controller that is slowed down by its
            speed alone and by all of its limits [J]; NaN where it cannot be so fast, or was not
            driven.
        lateness: Largest difference of arrival times [s].
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
        """Energy over that of the better kinematic controller."""
        better = min(self.speed_only, self.all_limits, key=lambda e: (math.isnan(e), e))
        return self.energy / better


def compare(
    robot: Mapping[str, Any],
    distance: float,
    bearing: float,
    changes: Mapping[str, Any],
    both: bool = True,
) -> Comparison:
    """Drive one goal both ways, the headings of start and goal 0.

    Args:
        robot: Full parameter names to values.
        distance, bearing: Of the goal [m, rad].
        changes: Full parameter names to values, of the planner.
        both: Whether the line is driven slower and softer too, or only slower.

    Raises:
        StudyError: One of the two does not arrive, or not at the same time.
    """
    goal = (distance * math.cos(bearing), distance * math.sin(bearing), 0.0)
    drive = planned(robot, Scene("free", goal, changes=changes)).drive
    if not math.isfinite(drive.arrival):
        raise StudyError(f"the planner did not arrive ({distance:g} m, {bearing:.2f} rad)")
    start = (0.0, 0.0, 0.0)
    ways = (False, True) if both else (False,)
    others = [at_equal_time(robot, start, goal, drive.arrival, whole) for whole in ways]
    rides = [other.drive for other in others if other is not None]
    taken = [math.nan if other is None else other.drive.taken() for other in others]
    taken += [math.nan] * (2 - len(taken))
    return Comparison(
        distance, bearing, drive.arrival, drive.taken(),
        float(np.abs(drive.poses[:, 2]).max()), taken[0], taken[1],
        max((abs(ride.arrival - drive.arrival) for ride in rides), default=math.nan),
    )  # fmt: skip


# ---- the diagonal -------------------------------------------------------------------------------


def diagonals(robot: Robot) -> Array:
    """Directions (k,) in base_link, in (-pi/2, pi/2], along which some wheels drive alone [rad].

    A wheel pushes along its roller's axis; across it, it stands still.
    """
    angles = np.array(robot.wheels.heading) + np.array(robot.wheels.roller_angle)
    half_turns: Array = np.unique(np.round(math.pi / 2 - (math.pi / 2 - angles) % math.pi, 6))
    return half_turns


def from_diagonal(angles: Array, robot: Robot) -> Array:
    """How far (k,) directions of travel (k,) are from the nearest diagonal [rad]."""
    off = angles[:, None] - diagonals(robot)
    result: Array = np.abs((off + math.pi / 2) % math.pi - math.pi / 2).min(axis=1)
    return result


def steady_power(robot: Robot, speed: float, directions: Array) -> Array:
    """Electric power (k,) [W] that holds a speed [m/s] in directions (k,) of base_link [rad].

    By the model's friction, with the least currents that balance it.
    """
    twists = speed * np.column_stack(
        [np.cos(directions), np.sin(directions), np.zeros(len(directions))]
    )
    return economy.power(PlanningModel.of(robot), twists)


def slant_figures(drive: Drive, robot: Robot) -> dict[str, Any]:
    """Whether and when the robot travelled along a diagonal of its rollers."""
    times, angles = drive.slant()
    off = from_diagonal(angles, robot)
    if not len(off):
        return {"along_diagonal": False, "share": 0.0, "nearest_rad": math.nan,
                "nearest_s": math.nan, "peak_turn_rad": 0.0}  # fmt: skip
    near = off <= NEAR_DIAGONAL
    turned = np.abs(drive.poses[:, 2] - drive.poses[0, 2])
    return {
        "along_diagonal": bool(near.mean() > 0.5),
        "share": float(near.mean()),
        "nearest_rad": float(off.min()),
        "nearest_s": float(times[off.argmin()]),
        "peak_turn_rad": float(turned.max()),
        "peak_turn_s": float(drive.times[turned.argmax()]),
    }


# ---- the scenes ---------------------------------------------------------------------------------
def _scene(case: Case, **more: Any) -> Scene:
    circles = tuple(circle(RADIUS, way) for way in case.ways)
    return Scene(case.name, case.goal, case.start, circles, **more)


def free() -> Scene:
    """Nothing in the way."""
    return _scene(CASES["free"], snapshots=(2.0, 3.5, 7.0))


def corridor() -> Scene:
    """Four circles across the way: the robot fits through lengthwise only."""
    return _scene(CASES["corridor"], snapshots=(0.8, 1.9, 2.7, 3.4, 4.8))


def moving() -> Scene:
    """Circles cross the way from both sides, observed with noise."""
    return _scene(CASES["moving"], noise=0.01)


SCENES: Mapping[str, Callable[[], Scene]] = {"free": free, "corridor": corridor, "moving": moving}


@dataclass(frozen=True)
class Variant:
    """A way to drive the free case.

    Attributes:
        about: For people.
        robot: Full parameter names to values, of robot and plant.
        planner: The same, of the planner.
        voltages: Whether voltages are put out.
    """

    about: str
    robot: Mapping[str, Any] = field(default_factory=dict)
    planner: Mapping[str, Any] = field(default_factory=dict)
    voltages: bool = False


def variants(robot: Mapping[str, Any]) -> list[Variant]:
    """What decides whether the robot turns to travel along a diagonal; the first is the case."""
    coulomb = [2.0 * value for value in robot["friction.coulomb"]]
    return [
        Variant("defaults"),
        Variant("voltages put out", voltages=True),
        Variant("the paper's horizon and cost", planner=PAPER),
        Variant("W_ang 1/10", planner={"weights.heading": 15.0}),
        Variant("W_ang 1/100", planner={"weights.heading": 1.5}),
        Variant("no running cost, N = 20", planner={"weights.running": 0.0}),
        Variant("Coulomb friction x 2", robot={"friction.coulomb": coulomb}),
        Variant("rollers without drag", robot={"friction.roller": [0.0]}),
    ]


def goals(full: bool) -> Iterable[tuple[float, float]]:
    """Distances [m] and bearings [rad] of the energy table."""
    bearings = (0.0, 22.5, 45.0, 67.5, 90.0) if full else (0.0, 45.0, 90.0)
    for distance in (1.0, 2.0, 4.0):
        for bearing in bearings:
            yield distance, math.radians(bearing)
