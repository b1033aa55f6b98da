"""Drives through random scenes: the true robot of a scene, judged outcomes, and their figures.

A drive is judged from true poses and true obstacles alone, by code that the planner does not
share: `scene_judge` decides whether the robot touched anything, between the samples too, and
`space_time_search` whether any path existed.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.scene_generator import Mismatch, RandomScene
from omniman_ros.lab.studies.scene_geometry import Box
from omniman_ros.lab.studies.scene_judge import Verdict, judge
from omniman_ros.lab.studies.space_time_grid import Mover
from omniman_ros.lab.studies.space_time_search import avoidable, find_way
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters

LIMIT = 60.0
"""Time after sending within which a goal must be reached [s]."""
NEAR = (0.04, 0.04)
"""True distance [m] and angle [rad] from the goal up to which an arrival counts: the planner
arrives by its odometry, which has drifted by then."""
AIM_REACHED = 0.95
"""Aim: smallest share of the reachable goals that the robot reaches."""
VELOCITY_SAMPLES = 4
"""Number of samples over which the velocity at a turn is measured."""
SURPRISE_WINDOW = 1.5
"""Time after a turn of an obstacle in which an unavoidable contact is looked for [s]."""
HEAVY = ("body.mass", "body.inertia", "arm.mass", "arm.inertia")
"""Parameters of the robot that the factor of the mass applies to."""


# ---- the robot ----------------------------------------------------------------------------------


def true_robot(
    robot: Mapping[str, Any], mismatch: Mismatch
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the parameters of the true robot, which differs from the planner's model.

    Args:
        robot: Parameters of planner and controller, full names to values.
        mismatch: Factors of mass, friction and motor constant.

    Returns:
        Parameters of the robot, and of the simulation.
    """
    values = dict(robot)
    for name in HEAVY:
        if name in values:
            values[name] = values[name] * mismatch.mass
    # The simulation's own factor is of the wheels' friction only.
    values["friction.roller"] = [value * mismatch.friction for value in robot["friction.roller"]]
    simulation = {
        "mismatch.friction": (mismatch.friction,),
        "mismatch.torque_constant": (mismatch.motor_constant,),
    }
    build(SimulationParameters, simulation)  # raises if a factor is out of range
    return values, simulation


def box_of(robot: Mapping[str, Any]) -> Box:
    """Return the robot's outline."""
    body = build(Robot, robot).body
    return Box(body.length, body.width)


@dataclass(frozen=True)
class Agility:
    """Ability of a robot to react to unforeseeable events.

    Attributes:
        acceleration: Largest acceleration in any direction [m/s^2].
        reaction: Longest time from an event to the first observation that shows it [s].

    Raises:
        InputError: A value is negative or not finite.
    """

    acceleration: float
    reaction: float

    def __post_init__(self) -> None:
        for name in ("acceleration", "reaction"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise InputError(f"{name} must be 0 or more, got {getattr(self, name)}")


def agility_of(robot: Mapping[str, Any], reaction: float) -> Agility:
    """Return the robot's agility for observations that show an event after a time [s]."""
    limits = build(PlannerParameters, robot).limits
    return Agility(max(limits.linear_acceleration, limits.linear_deceleration), reaction)


def mover_of(robot: Mapping[str, Any]) -> Mover:
    """Return outline and largest speeds of the robot; its accelerations are not limited."""
    limits = build(PlannerParameters, robot).limits
    return Mover(box_of(robot), limits.linear_velocity, limits.angular_velocity)


# ---- a drive ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SceneDrive:
    """A drive in a scene: K samples from the sending of the goal to the arrival or the end.

    Attributes:
        times: (K,) times on the clock of the obstacles [s].
        poses: (K, 3) true poses in odom [m, m, rad].
        energy: Electric energy consumed, less the energy fed back [J].
        arrived: Whether the planner reported its arrival.
        answers: (C,) times from the begin of a cycle to its reference, for each cycle that
            planned [s].
        late: Number of answers after the planner's deadline.
        drift: Distance of odometry from the truth at the end [m].
        state: State of the planner at the end.
        last: Last status text of the planner.
        whys: Reasons why plans were not used, with their numbers.

    Raises:
        InputError: There is no sample.
    """

    times: Array
    poses: Array
    energy: float
    arrived: bool
    answers: Array
    late: int
    drift: float
    state: str
    last: str
    whys: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.times) < 1 or self.poses.shape != (len(self.times), 3):
            raise InputError(
                f"a drive needs poses (K, 3) at times (K,), got {self.poses.shape} "
                f"at {self.times.shape}"
            )


@dataclass(frozen=True)
class Outcome:
    """The judged outcome of a drive.

    Attributes:
        scene: The scene.
        drive: The drive.
        verdict: Verdict of the judge.
        solvable: Whether a path exists; a robot that reached its goal has found one.
        avoidable: Whether the robot touched something that a robot with knowledge of the future
            and without limits of acceleration could have avoided.
        surprised: Whether what the robot touched had turned too late for any robot to avoid it.
    """

    scene: RandomScene
    drive: SceneDrive
    verdict: Verdict
    solvable: bool
    avoidable: bool
    surprised: bool

    @property
    def own(self) -> bool:
        """Whether the robot touched something that one without inertia could have avoided."""
        return self.avoidable

    @property
    def off(self) -> tuple[float, float]:
        """True distance [m] and angle [rad] from the goal at the end."""
        error = self.drive.poses[-1] - np.array(self.scene.goal)
        return math.hypot(error[0], error[1]), abs(se2.wrap(float(error[2])))

    @property
    def reached(self) -> bool:
        """Whether the robot is at its goal, has reported that, and had no contact."""
        near = all(is_off <= most for is_off, most in zip(self.off, NEAR, strict=True))
        return self.drive.arrived and near and not self.verdict.collided

    @property
    def other(self) -> bool:
        """Whether the robot touched something that it could not avoid."""
        return self.verdict.collided and not self.own

    @property
    def left(self) -> bool:
        """Whether a corner of the robot left its workspace."""
        return self.verdict.outside > 0.0

    @property
    def moving(self) -> bool:
        """Whether there are moving obstacles."""
        return not all(obstacle.fixed for obstacle in self.scene.obstacles)

    @property
    def mismatch(self) -> bool:
        """Whether the robot differs from its model."""
        return self.scene.mismatch != Mismatch()

    @property
    def failed(self) -> bool:
        """Whether this counts against the robot."""
        return self.own or self.left or (self.solvable and not self.reached)

    def figures(self) -> dict[str, Any]:
        """Return the figures of the drive; times [s], energies [J], gaps [m]."""
        drive, verdict = self.drive, self.verdict
        since = float(drive.times[0])
        return {
            "seed": self.scene.seed,
            "blocked": self.scene.blocked,
            "mismatch": self.mismatch,
            "moving": self.moving,
            "solvable": self.solvable,
            "reached": self.reached,
            "collided": verdict.collided,
            "own": self.own,
            "avoidable": self.avoidable,
            "surprised": self.surprised,
            "contact_s": verdict.contact - since if verdict.collided else math.nan,
            "touched": None if verdict.touched is None else list(verdict.touched),
            "clearance_m": verdict.gap,
            "outside_m": verdict.outside,
            "time_s": float(drive.times[-1]) - since,
            "energy_j": drive.energy,
            "off_m": self.off[0],
            "off_rad": self.off[1],
            "drift_m": drive.drift,
            "end": drive.poses[-1].tolist(),
            "state": drive.state,
            "last": drive.last,
            "whys": dict(drive.whys),
            "cycles": len(drive.answers),
            "late": drive.late,
            **spread(drive.answers),
        }


def judged(scene: RandomScene, drive: SceneDrive, mover: Mover, agility: Agility) -> Outcome:
    """Judge a drive.

    Args:
        scene: The scene.
        drive: The drive.
        mover: Outline and speeds of the robot, by which avoidable contacts are judged.
        agility: Agility of the robot, by which surprises are judged.
    """
    world = scene.world
    verdict = judge(drive.times, drive.poses, mover.box, world)
    could = late = False
    if verdict.collided:
        way = avoidable(mover, world, drive.times, drive.poses, verdict.contact)
        could, late = way is not None, surprised(scene, drive, verdict, mover.box, agility)
    outcome = Outcome(scene, drive, verdict, True, could, late)
    if outcome.reached and not outcome.left:
        return outcome
    since = float(drive.times[0])
    found = find_way(mover, world, scene.start, scene.goal, since, since + LIMIT)
    return replace(outcome, solvable=found is not None)


def surprised(
    scene: RandomScene, drive: SceneDrive, verdict: Verdict, box: Box, agility: Agility
) -> bool:
    """Return whether an obstacle had turned too late for any robot to get away.

    When the obstacle turned, the robot was at a position p with a velocity v. Until the reaction
    time is over, the robot cannot know of the turn; afterwards, whatever it does, its centre at a
    time t is no farther from p + v t than a (t - reaction)^2 / 2. It is a surprise if there is a
    time at which the inner discs of robot and obstacle overlap for all of these positions, so that
    nothing could have helped. The discs are smaller than the bodies: a contact that is not proven
    to be a surprise counts against the robot.
    """
    if verdict.touched is None or verdict.touched[0] != "obstacle":
        return False
    obstacle = scene.obstacles[verdict.touched[1]]
    turns = [t for t in obstacle.place.times if drive.times[0] < t <= verdict.contact]
    if not turns:
        return False
    turn = turns[-1]
    row = min(max(int(np.searchsorted(drive.times, turn)), 1), len(drive.times) - 1)
    before = max(row - VELOCITY_SAMPLES, 0)
    place = drive.poses[row, :2]
    velocity = (place - drive.poses[before, :2]) / (drive.times[row] - drive.times[before])
    after = np.arange(0.0, SURPRISE_WINDOW, 0.01)
    free = np.maximum(after - agility.reaction, 0.0)
    reach = 0.5 * agility.acceleration * free**2
    centers = place + after[:, None] * velocity
    apart = np.hypot(*(centers - obstacle.place.at(drive.times[row] + after)).T)
    return bool((apart + reach < min(box.half) + min(obstacle.semi_axes)).any())


def spread(answers: Array) -> dict[str, float]:
    """Return median, p99 and largest of times (C,) [s], in milliseconds; NaN of no times."""
    if not len(answers):
        return {"answer_median_ms": math.nan, "answer_p99_ms": math.nan, "answer_max_ms": math.nan}
    median, p99, most = 1e3 * np.percentile(answers, (50.0, 99.0, 100.0))
    return {
        "answer_median_ms": float(median),
        "answer_p99_ms": float(p99),
        "answer_max_ms": float(most),
    }


# ---- many drives --------------------------------------------------------------------------------


def groups(outcomes: Sequence[Outcome]) -> dict[str, list[Outcome]]:
    """Group the drives by what makes a scene hard; groups without a drive are left out."""
    made = {
        "all": list(outcomes),
        "line blocked": [o for o in outcomes if o.scene.blocked],
        "line free": [o for o in outcomes if not o.scene.blocked],
        "model off by up to 20 %": [o for o in outcomes if o.mismatch],
        "model exact": [o for o in outcomes if not o.mismatch],
        "moving obstacles": [o for o in outcomes if o.moving],
        "fixed obstacles only": [o for o in outcomes if not o.moving],
    }
    return {name: members for name, members in made.items() if members}


def summary(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the figures of a group of drives.

    Times and energies are those of drives that reached their goals, gaps those of drives without
    contact: in this simulation, a contact does not hold the robot back.

    Raises:
        InputError: There is no drive.
    """
    if not outcomes:
        raise InputError("no drive to sum up")
    reached = [o for o in outcomes if o.reached]
    solvable = [o for o in outcomes if o.solvable]
    times = [float(o.drive.times[-1] - o.drive.times[0]) for o in reached]
    energies = [o.drive.energy for o in reached]
    gaps = [o.verdict.gap for o in outcomes if not o.verdict.collided]
    return {
        "drives": len(outcomes),
        "own_collisions": sum(o.own for o in outcomes),
        "other_collisions": sum(o.other for o in outcomes),
        "surprises": sum(o.surprised for o in outcomes),
        "left_workspace": sum(o.left for o in outcomes),
        "solvable": len(solvable),
        "reached": len(reached),
        "reached_share": len(reached) / len(outcomes),
        "reached_of_solvable": (
            sum(o.reached for o in solvable) / len(solvable) if solvable else math.nan
        ),
        "time_median_s": _median(times),
        "time_max_s": max(times, default=math.nan),
        "energy_median_j": _median(energies),
        "energy_sum_j": float(sum(energies)),
        "least_clearance_m": min(gaps, default=math.nan),
        "clearance_median_m": _median(gaps),
        "drift_max_m": max(o.drive.drift for o in outcomes),
        "cycles": sum(len(o.drive.answers) for o in outcomes),
        "late": sum(o.drive.late for o in outcomes),
        **spread(np.concatenate([o.drive.answers for o in outcomes])),
    }


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else math.nan


def aims(whole: Mapping[str, Any]) -> dict[str, bool | None]:
    """Return which aims the figures of all drives meet; None where nothing was measured."""
    share = whole["reached_of_solvable"]
    return {
        "own_collisions": whole["own_collisions"] == 0,
        "left_workspace": whole["left_workspace"] == 0,
        "reached": None if math.isnan(share) else share >= AIM_REACHED,
    }
