"""Drives through random scenes: the true robot of a scene, judged outcomes, and their figures.

A drive is judged from true poses and true obstacles alone, by code that it does not share with the
planner: `scene_geometry` decides whether the robot touched anything.
Every contact counts as the robot's fault, and every goal as reachable.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.lab.studies.scene_generator import Mismatch, RandomScene
from omniman_ros.lab.studies.scene_geometry import RectangularOutline, SceneVerdict, judge
from omniman_ros.simulation.plant.parameters import SimulationParameters

TIME_LIMIT = 60.0  #: from when the goal is sent [s]
#: Largest true distance [m] and angle [rad] from the goal at which an arrival counts. The planner
#: itself judges its arrival by odometry, which has drifted by then.
GOAL_TOLERANCE = (0.04, 0.04)
AIM_REACHED = 0.98  #: smallest fraction of reached goals
MASS_PARAMETERS = ("body.mass", "body.inertia", "arm.mass", "arm.inertia")


def true_robot(
    robot: Mapping[str, Any], mismatch: Mismatch
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the parameters of the true robot, which is not its model, and of the simulation."""
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


def box_of(robot: Mapping[str, Any]) -> RectangularOutline:
    """Return the robot's outline from its parameters, full names to values."""
    body = build(Platform, robot).body
    return RectangularOutline(body.length, body.width)


@dataclass(frozen=True)
class SceneDrive:
    """A drive through a scene: K samples from the sending of the goal to the end of the drive."""

    times: Array  #: (K,) times on the clock by which the obstacles move [s]
    poses: Array  #: (K, 3) true poses in odom [m, m, rad]
    energy: float  #: electric energy consumed, less the energy fed back [J]
    arrived: bool  #: whether the planner reported its arrival
    answers: Array  #: (C,) times from the beginning of a planning cycle to its reference [s]
    late: int  #: number of references published after the planner's deadline
    drift: float  #: distance of the pose by odometry from the true pose at the end [m]
    state: str  #: state of the planner at the end
    last_status: str  #: last status text of the planner
    touched: tuple[float, int] | None = None  #: time [s] and obstacle of the engine's contact


@dataclass(frozen=True)
class SceneOutcome:
    """A drive through a scene, and the verdict on it."""

    scene: RandomScene
    drive: SceneDrive
    verdict: SceneVerdict

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
    def left_workspace(self) -> bool:
        """Whether a corner of the robot left the workspace at any time."""
        return self.verdict.outside > 0.0

    @property
    def failed(self) -> bool:
        """Whether the robot touched something, left its workspace or did not arrive."""
        return self.left_workspace or not self.reached

    def figures(self) -> dict[str, Any]:
        """Return the figures of the drive for a result; their units are in their names."""
        drive, verdict = self.drive, self.verdict
        since = float(drive.times[0])
        return {
            "seed": self.scene.seed,
            "reached": self.reached,
            "collided": verdict.collided,
            "contact_s": verdict.contact - since if verdict.collided else math.nan,
            "touched": verdict.touched,
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
            "cycles": len(drive.answers),
            "late": drive.late,
            **answer_statistics(drive.answers),
        }


def judge_drive(scene: RandomScene, drive: SceneDrive, box: RectangularOutline) -> SceneOutcome:
    """Judge a drive through a scene; a contact by the engine counts beside one by the judge."""
    verdict = judge(drive.times, drive.poses, box, scene.obstacles, scene.workspace)
    if drive.touched is not None and drive.touched[0] < verdict.contact:
        contact, index = drive.touched
        verdict = replace(verdict, contact=contact, touched=index)
    return SceneOutcome(scene, drive, verdict)


def answer_statistics(answers: Array) -> dict[str, float]:
    """Return the median, p99 and largest of times (C,) [s], in milliseconds; NaN without times."""
    names = ("answer_median_ms", "answer_p99_ms", "answer_max_ms")
    values = 1e3 * np.percentile(answers, (50.0, 99.0, 100.0)) if len(answers) else [math.nan] * 3
    return dict(zip(names, map(float, values), strict=True))


def groups(outcomes: Sequence[SceneOutcome]) -> dict[str, list[SceneOutcome]]:
    """Group drives by what makes a scene difficult; groups without a drive are left out."""
    members_by_name = {
        "all": list(outcomes),
        "line blocked": [o for o in outcomes if o.scene.blocked],
        "model off by up to 20 %": [o for o in outcomes if o.scene.mismatch != Mismatch()],
        "moving obstacles": [
            o for o in outcomes if not all(e.is_fixed for e in o.scene.obstacles)
        ],
    }
    return {name: members for name, members in members_by_name.items() if members}


def summary(outcomes: Sequence[SceneOutcome]) -> dict[str, Any]:
    """Return the figures of a group of drives, at least one; their units are in their names.

    Times and energies are those of the drives that reached their goals. Gaps are those of the
    drives without contact, as the simulation lets a robot drive on through what it touches.
    """
    reached = [o for o in outcomes if o.reached]
    gaps = [o.verdict.gap for o in outcomes if not o.verdict.collided]
    times = [float(o.drive.times[-1] - o.drive.times[0]) for o in reached]

    def median(values: Sequence[float]) -> float:
        return float(np.median(values)) if len(values) else math.nan

    return {
        "drives": len(outcomes),
        "contacts": sum(o.verdict.collided for o in outcomes),
        "left_workspace": sum(o.left_workspace for o in outcomes),
        "reached": len(reached),
        "reached_share": len(reached) / len(outcomes),
        "time_median_s": median(times),
        "time_max_s": max(times, default=math.nan),
        "energy_median_j": median([o.drive.energy for o in reached]),
        "least_clearance_m": min(gaps, default=math.nan),
        "drift_max_m": max(o.drive.drift for o in outcomes),
        "cycles": sum(len(o.drive.answers) for o in outcomes),
        "late": sum(o.drive.late for o in outcomes),
        **answer_statistics(np.concatenate([o.drive.answers for o in outcomes])),
    }


def aims(whole: Mapping[str, Any]) -> dict[str, bool]:
    """Return whether the figures of all drives, see `summary`, meet each aim."""
    return {
        "contacts": whole["contacts"] == 0,
        "left_workspace": whole["left_workspace"] == 0,
        "reached_share": whole["reached_share"] >= AIM_REACHED,
    }
