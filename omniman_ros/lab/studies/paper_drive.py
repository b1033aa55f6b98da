"""Drives with the problem of MPC 2021 itself: its first voltages are applied, stage by stage.

As in the paper's simulator the state is known exactly, and the robot waits for the solver.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.mpc_loop import MotionRecord
from omniman_ros.lab.studies.paper_problem import (
    STAGE,
    PaperPlan,
    PaperProblem,
    PaperWeights,
    VoltageModel,
)
from omniman_ros.lab.studies.recorded_drive import REST_SPEED, Drive
from omniman_ros.lab.studies.roller_diagonals import (
    angle_from_diagonal,
    diagonal_figures,
    roller_diagonals,
)
from omniman_ros.planning.cases import CASES, SIDEWAYS, Pose
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.parameters import Arrival
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives

TICK = 0.005
"""Time between two rows of the record [s]."""
TICKS = round(STAGE / TICK)
"""Number of ticks per stage."""
COMMAND_TICKS = 10
"""Number of ticks after which voltages are sent again, before the watchdog of the drives acts."""
STANDING_TIME = 1.0
"""Time at rest after which a drive ends [s]."""
TIME_LIMIT = 20.0
"""Time after which a drive ends in any case [s]."""
SNAPSHOTS = (2.0 / 9.0, 3.5 / 9.0, 7.0 / 9.0)
"""Times of the snapshots of Fig. 4 as shares of its duration, 2, 3.5 and 7 of 9 s [-]."""
SATURATION = 0.99
"""Share of the largest voltage from which on a motor counts as saturated [-]."""
PACKAGE_WEIGHTS = PaperWeights(600.0, 150.0)
"""Weights of the package's planner."""
COMPARED_WAY = 5.0
"""Length of the path at which times and energies of drives are compared [m]."""
TURNING_WEIGHTS = PaperWeights(20.0, 5.0)
"""A thirtieth of them: weights with which the robot turns to a roller diagonal."""


class Ground(Enum):
    """What the voltages drive.

    SLIPPING: the plant as the robot's file has it: wheels slip, rollers drag, dry friction needs
    a fifth more to start, the amplifier limits the current. GRIPPING: the plant with the
    assumptions of MPC 2021, 2: no slip, no drag, one dry friction, no limit but that of voltage.
    MODEL: the planner's own model, which then predicts exactly. In the plants a gear that is
    driven by its wheel loses 1 / eta; in (22), and so in the model, it is eta always.
    """

    SLIPPING = "plant"
    GRIPPING = "plant without slip and roller drag"
    MODEL = "the planner's model"


@dataclass(frozen=True)
class PaperVariant:
    """A setting of the free case with the paper's problem.

    Attributes:
        about: Description of what differs.
        weights: Weights of (31).
        robot: Parameters that differ, in the planner's model and in the plant, full names to
            values.
        bearing: Direction of the goal as seen from the start [rad].
        ground: What the voltages drive.
        integrated: Whether the energy is integrated within the stages.
    """

    about: str
    weights: PaperWeights
    robot: Mapping[str, Any] = field(default_factory=dict)
    bearing: float = SIDEWAYS
    ground: Ground = Ground.SLIPPING
    integrated: bool = False


def paper_variants(robot: Mapping[str, Any]) -> list[PaperVariant]:
    """Return the variants: weights first, then one change at a time, then the ground.

    The paper gives neither weights nor mass, friction and bearing of its robot.

    Args:
        robot: Parameters of the robot, full names to values.
    """

    def coulomb(factor: float) -> dict[str, Any]:
        return {"friction.coulomb": [factor * value for value in robot["friction.coulomb"]]}

    def mass(factor: float) -> dict[str, Any]:
        return {name: factor * robot[name] for name in ("body.mass", "body.inertia")}

    high, low = PACKAGE_WEIGHTS, TURNING_WEIGHTS
    return [
        PaperVariant("weights", high),
        PaperVariant("weights", low),
        *(PaperVariant("weights", PaperWeights(w, w / 4.0)) for w in (150.0, 50.0, 10.0)),
        PaperVariant("W_ang = W_pos", PaperWeights(20.0, 20.0)),
        PaperVariant("heading held", PaperWeights(20.0, 500.0)),
        PaperVariant("no Coulomb friction", low, coulomb(0.0)),
        PaperVariant("Coulomb friction x 1/2", low, coulomb(0.5)),
        PaperVariant("Coulomb friction x 2", low, coulomb(2.0)),
        PaperVariant("mass x 1/2", low, mass(0.5)),
        PaperVariant("mass x 2", low, mass(2.0)),
        PaperVariant("goal straight ahead", low, bearing=0.0),
        PaperVariant("goal along a diagonal", low, bearing=math.radians(45.0)),
        PaperVariant("energy integrated", low, integrated=True),
        PaperVariant("no Coulomb friction", high, coulomb(0.0)),
        PaperVariant("Coulomb friction x 2", high, coulomb(2.0)),
        PaperVariant("mass x 2", high, mass(2.0)),
        *(
            PaperVariant(ground.value, weights, ground=ground)
            for ground in (Ground.GRIPPING, Ground.MODEL)
            for weights in (low, high)
        ),
    ]


class Driven(Protocol):
    """A robot that is driven by voltages."""

    @property
    def state(self) -> Array:
        """(6,) pose in odom [m, m, rad], body twist [m/s, m/s, rad/s]."""

    @property
    def energy(self) -> float:
        """Electric energy consumed so far [J]."""

    def apply(self, voltages: Array) -> None:
        """Apply voltages (w,) [V] for one tick."""


class _Plant:
    """The simulated drives, which share no code with the model."""

    def __init__(self, robot: Robot, simulation: SimulationParameters, start: Pose) -> None:
        self._drives = SimulatedDrives(robot, simulation)
        self._drives.set_pose(start)
        self._drives.advance(0.0)
        self._tick = 0

    @property
    def state(self) -> Array:
        """See `Driven`."""
        return np.concatenate(self._drives.ground_truth())

    @property
    def energy(self) -> float:
        """See `Driven`."""
        return float(self._drives.electrical()[:, 2].sum())

    def apply(self, voltages: Array) -> None:
        """See `Driven`."""
        if self._tick % COMMAND_TICKS == 0:
            self._drives.command_voltage(voltages, self._tick * TICK)
        self._tick += 1
        self._drives.advance(self._tick * TICK)


class _Model:
    """The planner's model."""

    def __init__(self, model: PlanningModel, start: Pose) -> None:
        self._transition = VoltageModel(model).transition(TICK, 1)
        self.state, self.energy = np.concatenate([start, np.zeros(3)]), 0.0

    def apply(self, voltages: Array) -> None:
        """See `Driven`."""
        end, energy = self._transition(self.state, voltages)
        self.state, self.energy = np.asarray(end).ravel(), self.energy + float(energy)


def driven(variant: PaperVariant, robot: Mapping[str, Any], start: Pose) -> Driven:
    """Return what the voltages of a variant drive.

    Args:
        variant: The variant.
        robot: Parameters of the robot, full names to values, with the variant's changes.
        start: Pose at the start in odom [m, m, rad].
    """
    if variant.ground is Ground.MODEL:
        return _Model(paper_model(robot), start)
    if variant.ground is Ground.SLIPPING:
        return _Plant(build(Robot, robot), build(SimulationParameters, {}), start)
    ideal = {"friction.roller": [0.0], "friction.mu": 5.0, "motor.max_current": 100.0}
    simulation = build(SimulationParameters, {"plant.breakaway": 1.0})
    return _Plant(build(Robot, {**robot, **ideal}), simulation, start)


def paper_model(robot: Mapping[str, Any]) -> PlanningModel:
    """Return the model (13) to (24) of a robot: its rollers do not drag.

    Args:
        robot: Parameters of the robot, full names to values.
    """
    return PlanningModel.of(build(Robot, {**robot, "friction.roller": [0.0]}))


@dataclass(frozen=True)
class PaperDrive:
    """A drive with the paper's problem.

    Attributes:
        variant: Its setting.
        drive: Record of the drive; its odometry is the true pose.
        voltages: (K, w) motor voltages that were applied [V].
        max_voltage: Largest voltage [V].
        stages: Number of stages.
        unsolved: Number of stages in which the solver did not converge.
    """

    variant: PaperVariant
    drive: Drive
    voltages: Array
    max_voltage: float
    stages: int
    unsolved: int

    @property
    def last(self) -> int:
        """Row of the first tick from which on the robot rests, or the last row."""
        moving = np.flatnonzero(np.abs(self.drive.twists).max(axis=1) >= REST_SPEED)
        return min(int(moving[-1]) + 1, len(self.drive.times) - 1) if len(moving) else 0

    @property
    def speeds(self) -> Array:
        """(K,) speeds [m/s]."""
        result: Array = np.hypot(self.drive.twists[:, 0], self.drive.twists[:, 1])
        return result

    @property
    def way(self) -> Array:
        """(K,) lengths of the driven path [m]."""
        steps = np.hypot(*np.diff(self.drive.poses[:, :2], axis=0).T)
        result: Array = np.concatenate([[0.0], np.cumsum(steps)])
        return result

    def way_shares(self, shares: Sequence[float]) -> Array:
        """Return the shares (k,) of the path that were driven after shares of the time [-]."""
        times, way = self.drive.times, self.way
        result: Array = np.interp(np.array(shares) * times[self.last], times, way / way[self.last])
        return result

    def saturated_share(self) -> float:
        """Return the share of the time until rest in which a motor has its largest voltage [-]."""
        largest = np.abs(self.voltages[: self.last]).max(axis=1, initial=0.0)
        return float((largest >= SATURATION * self.max_voltage).mean()) if self.last else 0.0

    def figures(self, robot: Robot) -> dict[str, Any]:
        """Return the figures of the drive for a result; their units are in their names.

        They hold until the robot rests, within `REST_SPEED`; `compared_s` and `compared_j` are
        time and energy at `COMPARED_WAY`, NaN if the robot stops before. `turn_to_diagonal_rad`
        is the turn at the largest speed, positive towards the diagonal that is nearest at the
        start.

        Args:
            robot: The robot, for its roller diagonals.
        """
        drive, last, speeds = self.drive, self.last, self.speeds
        fastest = int(speeds.argmax())
        there = np.flatnonzero(self.way >= COMPARED_WAY)
        compared = int(there[0]) if len(there) else None
        error = drive.goal - drive.poses[last]
        direction = np.arctan2(drive.twists[fastest : fastest + 1, 1], drive.twists[fastest, 0])
        offset = roller_diagonals(robot) - self.variant.bearing
        nearest = float(offset[np.abs(offset).argmin()])
        turn = float(drive.poses[fastest, 2] - drive.poses[0, 2])
        near = diagonal_figures(drive, robot)
        w = self.variant.weights
        return {
            "about": self.variant.about,
            "w_pos": w.position,
            "w_ang": w.heading,
            "changes": dict(self.variant.robot),
            "goal_m": math.dist(drive.goal[:2], drive.poses[0, :2].tolist()),
            "bearing_rad": self.variant.bearing,
            "ground": self.variant.ground.value,
            "energy_integrated": self.variant.integrated,
            "peak_speed_m_s": float(speeds[fastest]),
            "peak_speed_s": float(drive.times[fastest]),
            "rest_s": float(drive.times[last]),
            "rest_m": float(np.hypot(error[0], error[1])),
            "rest_rad": float(abs(error[2])),
            "way_m": float(self.way[last]),
            "way_shares": self.way_shares(SNAPSHOTS).tolist(),
            "energy_j": float(drive.energy[last]),
            "compared_s": math.nan if compared is None else float(drive.times[compared]),
            "compared_j": math.nan if compared is None else float(drive.energy[compared]),
            "saturated_share": self.saturated_share(),
            "along_diagonal": near["along_diagonal"],
            "share": near["share"],
            "peak_turn_rad": near["peak_turn_rad"],
            "turn_to_diagonal_rad": -math.copysign(1.0, nearest) * turn,
            "from_diagonal_at_peak_rad": float(angle_from_diagonal(direction, robot)[0]),
            "stages": self.stages,
            "unsolved": self.unsolved,
        }


def drive_paper(robot: Mapping[str, Any], variant: PaperVariant) -> PaperDrive:
    """Drive the free case with the paper's problem, until the robot rests.

    Args:
        robot: Parameters of the robot, full names to values.
        variant: The setting.
    """
    values = {**robot, **variant.robot}
    case = CASES["free"]
    start = (*case.start[:2], -variant.bearing)
    goal = (*case.goal[:2], -variant.bearing)
    model = paper_model(values)
    problem = PaperProblem(model, variant.weights, variant.integrated)
    body = driven(variant, values, start)
    record, voltages = MotionRecord(), []
    plan: PaperPlan | None = None
    unsolved, standing, tick = 0, 0, 0
    while tick * TICK < TIME_LIMIT and standing * TICK < STANDING_TIME:
        if tick % TICKS == 0:
            plan = problem.solve(body.state, np.array(goal), plan)
            unsolved += not plan.solved
        assert plan is not None
        state = body.state
        record.times.append(tick * TICK)
        record.poses.append(state[:3])
        record.odometry.append(state[:3])
        record.twists.append(state[3:])
        record.energy.append(body.energy)
        voltages.append(plan.voltages[0])
        resting = tick * TICK > STANDING_TIME and np.abs(state[3:]).max() < REST_SPEED
        standing = standing + 1 if resting else 0
        body.apply(plan.voltages[0])
        tick += 1
    drive = Drive.of(record, 0.0, goal, build(Arrival, {}), model.half)
    stages = math.ceil(tick / TICKS)
    return PaperDrive(variant, drive, np.array(voltages), problem.limit, stages, unsolved)
