"""The experiment of CCTA 2017 V.C: one drive along Fig. 7's path, and what it is judged by."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arbiter import Source
from omniman_ros.core.errors import OmnimanError, ParameterError
from omniman_ros.core.kinematics import PlatformKinematics
from omniman_ros.core.parameters import build
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.core.robot import Robot
from omniman_ros.drive.parameters import Mismatch, SimulationParameters
from omniman_ros.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.studies.figure7 import Figure7

Array = NDArray[np.float64]

NO_INTEGRAL = 100.0
"""Integral time of a P loop [s]: the integral part does nothing in a movement of 10 s."""
SPREAD = 0.2
"""Friction, torque constant and amplifier gain of a wheel are off by up to this."""
LEAD = 0.05
"""A movement is announced to the controller this long before it begins [s]."""
SMOOTHING = 0.105
"""Wheel speeds less their mean over this time are called noise [s]."""
TRACE_STRIDE = 4
"""Ticks between two samples of a kept course: 50 Hz."""


class StudyError(OmnimanError):
    """A drive did not come to its end; its figures would mean nothing."""


@dataclass(frozen=True)
class Group:
    """What the drives of a part of the study have in common.

    Attributes:
        about: For people.
        changes: Full parameter names to values, of controller and simulation.
        radius_spread: Radii of the wheels are off by up to this, and nobody knows.
    """

    about: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    radius_spread: float = 0.0


UNWATCHED = {"drive.following_error": 100.0}
"""P loops of unlike wheels can lag by more than a healthy robot's are allowed to: no stop."""
P_LOOPS = {"firmware.integral_time": NO_INTEGRAL}
ICE = {
    "drive.mode": "torque", "plant.patch_x_min": 0.4, "plant.patch_x_max": 0.7,
    "plant.patch_y_min": 0.1, "plant.patch_y_max": 2.0, "plant.patch_mu": 0.02,
}  # fmt: skip
GROUPS: Mapping[str, Group] = {
    "P": Group("P velocity loops", P_LOOPS),
    "PI": Group("PI velocity loops"),
    "radii": Group("P velocity loops, wheel radii off by up to 0.5 %", P_LOOPS, 0.005),
    "ice": Group("torque mode, across a patch of ice", ICE),
}


@dataclass(frozen=True)
class Case:
    """One drive of the study.

    Attributes:
        group: One of GROUPS.
        sample: Number of the random wheels.
        gain: k_epsilon, 0 for off [1/s].
        mismatch: How the wheels differ.
    """

    group: str
    sample: int
    gain: float
    mismatch: Mismatch


@dataclass(frozen=True)
class Setup:
    """What all drives of a study share: robot (full parameter names to values) and path."""

    robot: Mapping[str, Any]
    figure: Figure7

    def __post_init__(self) -> None:
        object.__setattr__(self, "robot", dict(self.robot))  # so that it can be pickled
        if build(Robot, self.robot).wheel_count == 3:
            raise ParameterError("robot", "3 wheels", "three wheels have no motion constraint")


@dataclass(frozen=True)
class Outcome:
    """What a drive is judged by.

    Attributes:
        epsilon_max, epsilon_rms: Of |epsilon| from the encoders since the start [rad].
        slip: Lost by slip of rollers on the floor [J].
        copper: Lost in the motors' windings [J].
        losses: All losses, these two included [J].
        energy: Work of the amplifiers [J].
        imbalance: Energy that the plant's ledger cannot account for [J].
        speed_noise: RMS of the measured wheel speeds less their mean over SMOOTHING [rad/s].
        command_noise: The same of the wheel speeds that are asked for [rad/s].
        odometry_end, odometry_max: Position of odometry off the truth [m].
        heading_end, heading_max: Heading of odometry off the truth, magnitude [rad].
        tracking_max: Largest distance of odometry from the reference, in odom [m].
        duration: From the first to the last tick [s].
    """

    epsilon_max: float
    epsilon_rms: float
    slip: float
    copper: float
    losses: float
    energy: float
    imbalance: float
    speed_noise: float
    command_noise: float
    odometry_end: float
    odometry_max: float
    heading_end: float
    heading_max: float
    tracking_max: float
    duration: float


@dataclass(frozen=True)
class Run:
    """A drive that was driven: `time` (k,) [s] and `epsilon` (k, m) [rad] at 50 Hz."""

    case: Case
    outcome: Outcome
    time: Array
    epsilon: Array


def draw_mismatch(group: str, seed: int, sample: int, wheels: int) -> Mismatch:
    """Random wheels: factors even in 1 +- SPREAD; the same in all groups but for the radii."""
    draw = np.random.default_rng([seed, sample]).uniform(-1.0, 1.0, (4, wheels))
    friction, constant, gain = (tuple((1.0 + SPREAD * row).tolist()) for row in draw[:3])
    radius = tuple((1.0 + GROUPS[group].radius_spread * draw[3]).tolist())
    return Mismatch(friction, constant, gain, radius)


def coupling_error(kinematics: PlatformKinematics, positions: Array) -> Array:
    """Epsilon (k, m) [rad] since the first of the wheels' positions (k, n) [rad].

    CCTA 2017 (12) and (24): epsilon' = T phi', so epsilon = T (phi - phi_0). Nothing resets it.
    """
    epsilon: Array = (positions - positions[0]) @ kinematics.T.T
    return epsilon


def noise(speeds: Array) -> float:
    """RMS of the wheel speeds (k, n) less their mean over SMOOTHING, in the speeds' unit."""
    half = round(SMOOTHING / PERIOD) // 2
    window = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    smooth = [np.convolve(column, window, "valid") for column in speeds.T]
    return float(np.sqrt(np.mean((speeds[half:-half] - np.column_stack(smooth)) ** 2)))


def drive(setup: Setup, case: Case) -> Run:
    """Drive along the path once.

    Raises:
        StudyError: The controller or the drives stopped, or the path was not followed.
        ParameterError: Robot, gain or mismatch are refused.
    """
    # Without torques: what watches over dead wheels takes no part in the experiment.
    loop = ClosedLoop(*_parameters(setup, case), torques=False)
    core, drives = loop.controller, loop.drives
    waiting = list(setup.figure.legs(loop.now))
    ticks = round(setup.figure.duration / PERIOD)
    rows: list[tuple[Array, ...]] = []
    tracking = 0.0
    for _ in range(ticks):
        if waiting and loop.now >= waiting[0].begin - LEAD:
            refusal = core.hear_preview(Source.PATH, waiting.pop(0).preview, loop.now)
            if refusal:
                raise StudyError(f"path/reference was refused: {refusal}")
        loop.step()
        stopped = core.cancelled or core.latch.status.reason or drives.stop_reason
        if stopped:
            raise StudyError(
                f"group {case.group}, sample {case.sample}, k = {case.gain:g}: {stopped}"
            )
        if core.arbiter.active is not None:
            tracking = max(tracking, float(np.hypot(*core.tracking_error[:2])))
        states = loop.states
        off = np.array(core.odometry.pose) - loop.truth
        rows.append((states.position, states.velocity, core.cascade.reference, off))
    position, speed, command, off = (np.array(column) for column in zip(*rows, strict=True))
    epsilon = coupling_error(core.cascade.kinematics, position)
    outcome = _judge(loop, epsilon, speed, command, off, tracking)
    time: Array = PERIOD * np.arange(ticks, dtype=np.float64)
    return Run(case, outcome, time[::TRACE_STRIDE], epsilon[::TRACE_STRIDE])


def _parameters(setup: Setup, case: Case) -> tuple[PlatformParameters, SimulationParameters]:
    values = {
        **setup.robot, **GROUPS[case.group].changes, **UNWATCHED,
        "coupling.k_epsilon": case.gain,
    }  # fmt: skip
    simulation = build(SimulationParameters, values)
    return build(PlatformParameters, values), replace(simulation, mismatch=case.mismatch)


def _judge(
    loop: ClosedLoop, epsilon: Array, speed: Array, command: Array, off: Array, tracking: float
) -> Outcome:
    size = np.linalg.norm(epsilon, axis=1)
    distance, turn = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])
    energy = loop.drives.energy
    losses = energy.losses
    return Outcome(
        epsilon_max=float(size.max()),
        epsilon_rms=float(np.sqrt(np.mean(size**2))),
        slip=losses["slip"],
        copper=losses["copper"],
        losses=sum(losses.values()),
        energy=energy.electrical,
        imbalance=energy.residual,
        speed_noise=noise(speed),
        command_noise=noise(command),
        odometry_end=float(distance[-1]),
        odometry_max=float(distance.max()),
        heading_end=float(turn[-1]),
        heading_max=float(turn.max()),
        tracking_max=tracking,
        duration=PERIOD * len(epsilon),
    )
