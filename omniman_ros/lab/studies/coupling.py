"""The experiment of CCTA 2017, section V.C: a drive along the path of Fig. 7, and its figures."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from omniman_ros.control.coupling_controller import CouplingController, CouplingParameters
from omniman_ros.core.arbiter import Source
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.lab.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.motion.figure7 import Figure7
from omniman_ros.simulation.plant.parameters import MismatchParameters

MISMATCH_SPREAD = 0.2  #: largest relative error of friction, torque constant and gain [-]
SENDING_LEAD = 0.05  #: time by which a movement is sent to the controller before it begins [s]
TRACE_STRIDE = 4  #: ticks from one sample of a recorded trace to the next, which gives 50 Hz


@dataclass(frozen=True)
class Group:
    """A group of drives with common parameters."""

    about: str  #: description of the group in the tables
    changes: Mapping[str, Any] = field(default_factory=dict)  #: parameters, full names to values
    radius_spread: float = 0.0  #: largest relative error of a radius, not known to the controller


#: Parameters that prevent a stop by the following error, as P loops of unequal wheels can lag by
#: more than a healthy robot may.
NO_FOLLOWING_ERROR_STOP = {"drive.following_error": 100.0}
P_LOOPS = {"firmware.integral_time": 100.0}  #: too long to matter in a movement of 10 s [s]
GROUPS: Mapping[str, Group] = {
    "P": Group("P velocity loops", P_LOOPS),
    "PI": Group("PI velocity loops"),
    "torque": Group("torque mode", {"drive.mode": "torque"}),
    "radii": Group("P velocity loops, wheel radii off by up to 0.5 %", P_LOOPS, 0.005),
}  #: Groups of drives, by name
OWN_CONTROLLER, PAPER_CONTROLLER, LAG_CONTROLLER = "package", "paper", "package, with lag"
"""Names of the coupling controllers."""
#: Changed parameters of each coupling controller. The paper's integrates from 0 to t, (24), and
#: has no bound of its own; its correction is the gain times that integral, (25), through J_a of
#: (14). The package's with lag knows the lag of the rollers, `Setup.roller_lag`; the others do
#: not.
CONTROLLERS: Mapping[str, Mapping[str, Any]] = {
    OWN_CONTROLLER: {},
    PAPER_CONTROLLER: {"coupling.reset_at_rest": False, "coupling.authority": 1.0},
    LAG_CONTROLLER: {},
}


@dataclass(frozen=True)
class CouplingCase:
    """One drive of the study."""

    group: str  #: name of the group, a key of GROUPS
    sample: int  #: index of the set of random wheels
    gain: float  #: k_epsilon [1/s]; 0 for no coupling control
    mismatch: MismatchParameters  #: errors of the wheels
    controller: str = OWN_CONTROLLER  #: name of the coupling controller, a key of CONTROLLERS


@dataclass(frozen=True)
class Setup:
    """Robot and path, which all drives of a study have in common."""

    robot: Mapping[str, Any]  #: parameters of the robot, full names to values
    figure: Figure7  #: the path as a function of time
    world: WorldChoice | None = None  #: world in which the robot drives; None for the plant
    roller_lag: float = 0.0  #: time by which its rollers take over late [s]

    def __post_init__(self) -> None:
        object.__setattr__(self, "robot", dict(self.robot))  # so that it can be pickled
        if build(Platform, self.robot).wheel_count == 3:
            raise ParameterError("robot", "3 wheels", "three wheels have no motion constraint")


@dataclass(frozen=True)
class CouplingFigures:
    """The figures of a drive."""

    epsilon_max: float  #: largest |epsilon| by CCTA 2017 (24), from the encoders [rad]
    error_max: float  #: largest |epsilon|, less what the lag of the rollers explains [rad]
    slip: float  #: energy dissipated by slip of the rollers on the floor [J]
    copper: float  #: energy dissipated in the windings of the motors [J]
    energy: float  #: electrical energy that the amplifiers deliver [J]
    odometry_end: float  #: position error of the odometry at the end [m]
    odometry_max: float  #: largest position error of the odometry [m]
    heading_end: float  #: magnitude of the heading error of the odometry at the end [rad]
    tracking_max: float  #: largest distance of the measured position from the reference [m]


@dataclass(frozen=True)
class CouplingRun:
    """A completed drive."""

    case: CouplingCase  #: the case
    outcome: CouplingFigures  #: its figures
    time: Array  #: (k,) times at 50 Hz [s]
    epsilon: Array  #: (k, m) coupling errors by CCTA 2017 (24), never reset [rad]


def draw_mismatch(group: str, seed: int, sample: int, wheels: int) -> MismatchParameters:
    """Draw the errors of a set of random wheels, which differ between groups by the radii only.

    Returns:
        Factors with a uniform distribution in 1 +- `MISMATCH_SPREAD`.
    """
    draw = np.random.default_rng([seed, sample]).uniform(-1.0, 1.0, (4, wheels))
    friction, constant, gain = (tuple((1.0 + MISMATCH_SPREAD * row).tolist()) for row in draw[:3])
    radius = tuple((1.0 + GROUPS[group].radius_spread * draw[3]).tolist())
    return MismatchParameters(friction, constant, gain, radius)


def drive(setup: Setup, case: CouplingCase) -> CouplingRun:
    """Drive along the path once."""
    values = {
        **setup.robot,
        **GROUPS[case.group].changes,
        **NO_FOLLOWING_ERROR_STOP,
        **CONTROLLERS[case.controller],
        "coupling.k_epsilon": case.gain,
        "coupling.roller_lag": setup.roller_lag if case.controller == LAG_CONTROLLER else 0.0,
    }
    loop = ClosedLoop.of_robot(values, setup.world, case.mismatch)
    core, drives = loop.controller, loop.drives
    rolling = CouplingController(
        core.cascade.kinematics, CouplingParameters(roller_lag=setup.roller_lag)
    )
    explained = np.zeros_like(rolling.error)
    pending = list(setup.figure.legs(loop.now))
    ticks = round(setup.figure.duration / PERIOD)
    rows: list[tuple[Array, Array, Array]] = []
    tracking = 0.0
    for _ in range(ticks):
        if pending and loop.now >= pending[0].begin - SENDING_LEAD:
            loop.send(Source.PATH, pending.pop(0).preview)
        loop.step()
        loop.check(f"group {case.group}, sample {case.sample}, k = {case.gain:g}")
        if core.arbiter.active is not None:
            tracking = max(tracking, float(np.hypot(*core.tracking_error[:2])))
        yaw_rate = float(core.odometry.twist[2])
        explained = explained + PERIOD * rolling.expected_rate(loop.states.velocity, yaw_rate)
        error = np.array(core.odometry.pose) - loop.truth
        rows.append((core.odometry.coupling_error, explained, error))
    epsilon, due, errors = (np.array(column) for column in zip(*rows, strict=True))
    distance = np.hypot(errors[:, 0], errors[:, 1])
    outcome = CouplingFigures(
        epsilon_max=float(np.linalg.norm(epsilon, axis=1).max()),
        error_max=float(np.linalg.norm(epsilon - due, axis=1).max()),
        slip=drives.energy.losses["slip"],
        copper=drives.energy.losses["copper"],
        energy=drives.energy.electrical,
        odometry_end=float(distance[-1]),
        odometry_max=float(distance.max()),
        heading_end=float(abs(errors[-1, 2])),
        tracking_max=tracking,
    )
    time: Array = PERIOD * np.arange(ticks, dtype=np.float64)
    return CouplingRun(case, outcome, time[::TRACE_STRIDE], epsilon[::TRACE_STRIDE])
