"""Drives through random scenes: the true robot of a scene, judged outcomes, and their figures.

A drive is judged from true poses and true obstacles alone, by code that it does not share with the
planner: `scene_judge` decides whether the robot touched anything, at the samples and between them,
and `space_time_search` whether any path existed.
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
from omniman_ros.lab.studies.space_time_search import find_avoiding_path, find_path
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters

TIME_LIMIT = 60.0
"""Time from when the goal is sent within which it must be reached [s]."""
GOAL_TOLERANCE = (0.04, 0.04)
"""Largest true distance [m] and angle [rad] from the goal at which an arrival counts. The planner
itself judges its arrival by odometry, which has drifted by then."""
AIM_REACHED = 0.98
"""Aim: smallest share of reached goals among those that can be reached."""
VELOCITY_SAMPLES = 4
"""Number of samples over which the robot's velocity is measured when an obstacle turns."""
SURPRISE_WINDOW = 1.5
"""Time after an obstacle changes its velocity within which a surprise is recognised [s]."""
MASS_PARAMETERS = ("body.mass", "body.inertia", "arm.mass", "arm.inertia")
"""Names of the robot's parameters to which the mass ratio of a mismatch applies."""


# ---- the robot ----------------------------------------------------------------------------------


def true_robot(
    robot: Mapping[str, Any], mismatch: Mismatch
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the parameters of the true robot, which differs from the planner's model.

    Args:
        robot: Parameters of planner and controller, full names to values.
        mismatch: Ratios of the true robot's mass, friction and motor constant to the model's.

    Returns:
        Parameters of the true robot and of the simulation, full names to values.

    Raises:
        ParameterError: A ratio is out of the simulation's range.
    """
    values = dict(robot)
    for name in MASS_PARAMETERS:
        if name in values:
            values[name] = values[name] * mismatch.mass
    # The simulation's own factor applies to the friction of the wheels, not to that of rollers.
    values["friction.roller"] = [value * mismatch.friction for value in robot["friction.roller"]]
    simulation = {
        "mismatch.friction": (mismatch.friction,),
        "mismatch.torque_constant": (mismatch.motor_constant,),
    }
    build(SimulationParameters, simulation)  # raises an error if a ratio is out of range
    return values, simulation


def box_of(robot: Mapping[str, Any]) -> Box:
    """Return the robot's outline from its parameters, full names to values."""
    body = build(Robot, robot).body
    return Box(body.length, body.width)


@dataclass(frozen=True)
class Agility:
    """A robot's ability to react to an obstacle that changes its velocity unforeseeably.

    Attributes:
        acceleration: Largest acceleration in any direction [m/s^2].
        reaction: Longest time from the change to the first observation that shows it [s].

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
    """Return the robot's agility.

    Args:
        robot: Parameters of the robot, full names to values.
        reaction: Longest time from an event to the first observation that shows it [s].
    """
    limits = build(PlannerParameters, robot).limits
    return Agility(max(limits.linear_acceleration, limits.linear_deceleration), reaction)


def mover_of(robot: Mapping[str, Any]) -> Mover:
    """Return the robot's outline and largest speeds from its parameters, full names to values."""
    limits = build(PlannerParameters, robot).limits
    return Mover(box_of(robot), limits.linear_velocity, limits.angular_velocity)


# ---- a drive ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SceneDrive:
    """A drive through a scene: K samples from the sending of the goal to the end of the drive.

    Attributes:
        times: (K,) times on the clock by which the obstacles move [s].
        poses: (K, 3) true poses in odom [m, m, rad].
        energy: Electric energy consumed, less the energy fed back [J].
        arrived: Whether the planner reported its arrival.
        answers: (C,) times from the beginning of a cycle to the publication of its reference, for
            each of the C cycles in which the planner planned [s].
        late: Number of references published after the planner's deadline.
        drift: Distance of the pose by odometry from the true pose at the end [m].
        state: State of the planner at the end.
        last_status: Last status text of the planner.
        rejections: Reasons why plans were not used, each with the number of such plans.
        touched: Time [s] of the first contact by the physics engine, and the index of the
            obstacle; None without a contact, and on the plant.

    Raises:
        InputError: There is no sample, or a shape is wrong.
    """

    times: Array
    poses: Array
    energy: float
    arrived: bool
    answers: Array
    late: int
    drift: float
    state: str
    last_status: str
    rejections: Mapping[str, int] = field(default_factory=dict)
    touched: tuple[float, int] | None = None

    def __post_init__(self) -> None:
        if len(self.times) < 1 or self.poses.shape != (len(self.times), 3):
            raise InputError(
                f"a drive needs poses (K, 3) at times (K,), got {self.poses.shape} "
                f"at {self.times.shape}"
            )


@dataclass(frozen=True)
class Outcome:
    """A drive through a scene and how it was judged.

    Attributes:
        scene: The scene.
        drive: The drive.
        verdict: Verdict of the judge.
        solvable: Whether a path to the goal exists; if the robot reached its goal, one does.
        avoidable: Whether the robot touched something that a robot with knowledge of the future
            and unlimited accelerations could have avoided.
        surprised: Whether the obstacle that the robot touched had changed its velocity too late
            for any robot to avoid it. This is reported only: it excuses no contact.
    """

    scene: RandomScene
    drive: SceneDrive
    verdict: Verdict
    solvable: bool
    avoidable: bool
    surprised: bool

    @property
    def at_fault(self) -> bool:
        """Whether the robot is at fault for a contact: it was avoidable."""
        return self.avoidable

    @property
    def goal_error(self) -> tuple[float, float]:
        """True distance [m] and angle [rad] from the goal at the end."""
        error = self.drive.poses[-1] - np.array(self.scene.goal)
        return math.hypot(error[0], error[1]), abs(se2.wrap(float(error[2])))

    @property
    def reached(self) -> bool:
        """Whether the robot is at its goal, its planner reported so, and it touched nothing."""
        errors = zip(self.goal_error, GOAL_TOLERANCE, strict=True)
        near = all(error <= tolerance for error, tolerance in errors)
        return self.drive.arrived and near and not self.verdict.collided

    @property
    def inevitable_contact(self) -> bool:
        """Whether the robot touched something, but not through its own fault."""
        return self.verdict.collided and not self.at_fault

    @property
    def left_workspace(self) -> bool:
        """Whether a corner of the robot left the workspace at any time."""
        return self.verdict.outside > 0.0

    @property
    def moving(self) -> bool:
        """Whether the scene has moving obstacles."""
        return not all(obstacle.fixed for obstacle in self.scene.obstacles)

    @property
    def mismatch(self) -> bool:
        """Whether the true robot differs from its model."""
        return self.scene.mismatch != Mismatch()

    @property
    def failed(self) -> bool:
        """Whether the robot failed: a contact by its fault, outside the workspace, or no arrival.

        A goal that is not reached is a failure only if a path to it exists.
        """
        return self.at_fault or self.left_workspace or (self.solvable and not self.reached)

    def figures(self) -> dict[str, Any]:
        """Return the figures of the drive for a result; their units are in their names."""
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
            "own": self.at_fault,
            "avoidable": self.avoidable,
            "surprised": self.surprised,
            "contact_s": verdict.contact - since if verdict.collided else math.nan,
            "touched": None if verdict.touched is None else list(verdict.touched),
            "clearance_m": verdict.gap,
            "outside_m": verdict.outside,
            "time_s": float(drive.times[-1]) - since,
            "energy_j": drive.energy,
            "off_m": self.goal_error[0],
            "off_rad": self.goal_error[1],
            "drift_m": drive.drift,
            "end": drive.poses[-1].tolist(),
            "state": drive.state,
            "last": drive.last_status,
            "whys": dict(drive.rejections),
            "cycles": len(drive.answers),
            "late": drive.late,
            **answer_statistics(drive.answers),
        }


def judge_drive(scene: RandomScene, drive: SceneDrive, mover: Mover, agility: Agility) -> Outcome:
    """Judge a drive through a scene; a contact by the engine counts beside one by the judge.

    Args:
        scene: The scene.
        drive: The drive.
        mover: Outline and speeds of the robot, for the search for paths.
        agility: Agility of the robot, which decides what counts as a surprise.
    """
    world = scene.world
    verdict = judge(drive.times, drive.poses, mover.box, world)
    if drive.touched is not None and drive.touched[0] < verdict.contact:
        contact, index = drive.touched
        verdict = replace(verdict, contact=contact, touched=("obstacle", index))
    could_avoid = was_surprised = False
    if verdict.collided:
        path = find_avoiding_path(mover, world, drive.times, drive.poses, verdict.contact)
        could_avoid = path is not None
        was_surprised = surprised(scene, drive, verdict, mover.box, agility)
    outcome = Outcome(scene, drive, verdict, True, could_avoid, was_surprised)
    if outcome.reached and not outcome.left_workspace:
        return outcome
    since = float(drive.times[0])
    found = find_path(mover, world, scene.start, scene.goal, since, since + TIME_LIMIT)
    return replace(outcome, solvable=found is not None)


def surprised(
    scene: RandomScene, drive: SceneDrive, verdict: Verdict, box: Box, agility: Agility
) -> bool:
    """Return whether the touched obstacle changed its velocity too late for any robot to evade.

    At that change, the robot was at a position p with a velocity v. It cannot know of the change
    until its reaction time has passed. At a time t after the change, whatever the robot does, its
    centre is no farther from p + v t than a (t - reaction)^2 / 2, where a is its largest
    acceleration. The contact is a surprise if there is a time t at which the inscribed discs of
    robot and obstacle overlap for all of these positions. As the discs are smaller than the
    bodies, not every inevitable contact is recognised as a surprise.

    Args:
        scene: The scene.
        drive: The drive.
        verdict: Verdict on the drive.
        box: The robot's outline.
        agility: Acceleration and reaction time of the robot.
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
    reacting = np.maximum(after - agility.reaction, 0.0)
    reach = 0.5 * agility.acceleration * reacting**2
    centers = place + after[:, None] * velocity
    distances = np.hypot(*(centers - obstacle.place.at(drive.times[row] + after)).T)
    return bool((distances + reach < min(box.half) + min(obstacle.semi_axes)).any())


def answer_statistics(answers: Array) -> dict[str, float]:
    """Return the median, p99 and largest of times (C,) [s], in milliseconds; NaN without times."""
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
    """Group drives by what makes a scene difficult; groups without a drive are left out."""
    members_by_name = {
        "all": list(outcomes),
        "line blocked": [o for o in outcomes if o.scene.blocked],
        "line free": [o for o in outcomes if not o.scene.blocked],
        "model off by up to 20 %": [o for o in outcomes if o.mismatch],
        "model exact": [o for o in outcomes if not o.mismatch],
        "moving obstacles": [o for o in outcomes if o.moving],
        "fixed obstacles only": [o for o in outcomes if not o.moving],
    }
    return {name: members for name, members in members_by_name.items() if members}


def summary(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the figures of a group of drives for a result; their units are in their names.

    Times and energies are those of the drives that reached their goals. Gaps are those of the
    drives without contact, as the simulation lets a robot drive on through what it touches.

    Raises:
        InputError: There is no drive.
    """
    if not outcomes:
        raise InputError("there is no drive to summarise")
    reached = [o for o in outcomes if o.reached]
    solvable = [o for o in outcomes if o.solvable]
    times = [float(o.drive.times[-1] - o.drive.times[0]) for o in reached]
    energies = [o.drive.energy for o in reached]
    gaps = [o.verdict.gap for o in outcomes if not o.verdict.collided]
    return {
        "drives": len(outcomes),
        "own_collisions": sum(o.at_fault for o in outcomes),
        "other_collisions": sum(o.inevitable_contact for o in outcomes),
        "surprises": sum(o.surprised for o in outcomes),
        "left_workspace": sum(o.left_workspace for o in outcomes),
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
        **answer_statistics(np.concatenate([o.drive.answers for o in outcomes])),
    }


def _median(values: Sequence[float]) -> float:
    """Return the median of values; NaN without values."""
    return float(np.median(values)) if len(values) else math.nan


def aims(whole: Mapping[str, Any]) -> dict[str, bool | None]:
    """Return whether the figures of all drives meet each aim; None where nothing was measured.

    Args:
        whole: Figures of all drives, see `summary`.
    """
    share = whole["reached_of_solvable"]
    return {
        "own_collisions": whole["own_collisions"] == 0,
        "left_workspace": whole["left_workspace"] == 0,
        "reached": None if math.isnan(share) else share >= AIM_REACHED,
    }
