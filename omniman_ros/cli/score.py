"""Judgement of the demo: figures from what was recorded, and what is wrong with them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.cli import stop_leg, tool_leg
from omniman_ros.cli.crossing import Crossing
from omniman_ros.cli.figures import TwistPhase
from omniman_ros.cli.recorder import Recording, Row
from omniman_ros.cli.stop_leg import DrivenStop
from omniman_ros.cli.tool_leg import ToolTrack

Array = NDArray[np.float64]

TRACKING = (
    "rms_mm", "max_mm", "heading_rms_deg", "heading_max_deg", "final_mm", "final_heading_deg"
)  # fmt: skip
SETTLING = 1.0
"""Time after which a robot is to drive the twist that it is asked for [s]."""

RESTING = 0.5
"""Time after a movement in which the robot stands at its end [s]."""

LIMITS = {
    "twist error, m/s": 0.03,
    "twist error, rad/s": 0.05,
    "tracking RMS, mm": 5.0,
    "tracking max, mm": 20.0,
    "final position, mm": 10.0,
    "final heading, deg": 1.0,
    "odometry position, mm": 100.0,
    "odometry heading, deg": 6.0,
    "goal position, mm": 40.0,
    "goal heading, deg": 3.0,
    "arm final position, mrad": 3.0,
    "arm behind its reference, ms": 100.0,
    "arm off its path, mrad": 10.0,
    "tool off its path RMS, mm": 2.0,
    "tool off its path max, mm": 5.0,
    "dead wheel noticed, s": 2.0,
    "tracking without a wheel RMS, mm": 20.0,
    "at rest after an emergency stop, s": 1.0,
    "arm at rest after an emergency stop, s": 1.0,
    "moved after the reset, mm": 1.0,
    "arm moved after the reset, mrad": 1.0,
    "odom rate, Hz": 80.0,
    "wheel_commands rate, Hz": 160.0,
}
"""What a demo must keep to; rates are the least, the others the most."""

SAME_TICK = 1e-3
"""Points of the reference that are nearer to each other are one [s]."""
STALL = 0.15
"""Time without the processor that can spoil a demo [s]."""


@dataclass(frozen=True)
class DrivenTwist:
    """A phase of twists and when it began in ROS time [s]."""

    phase: TwistPhase
    start: float


@dataclass(frozen=True)
class DrivenLeg:
    """A movement of the path, from when to when in ROS time [s]."""

    name: str
    start: float
    end: float


@dataclass(frozen=True)
class DrivenGoal:
    """A goal (x, y, theta) in odom that was driven to among obstacles; times in ROS time [s]."""

    goal: tuple[float, float, float]
    crossing: Crossing
    start: float
    end: float


@dataclass(frozen=True)
class DrivenWithoutWheel:
    """A path on which a wheel lost its torque; when, and when it was noticed, in ROS time [s]."""

    wheel: str
    lost: float
    noticed: float
    leg: DrivenLeg


@dataclass(frozen=True)
class ArmMove:
    """Joint angles [rad] that the arm was sent to, from when to when in ROS time [s]."""

    goal: tuple[float, ...]
    start: float
    end: float = math.nan


def rms(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def wrapped(angle: Array) -> Array:
    """Angles in [-pi, pi] [rad]."""
    result: Array = np.remainder(angle + math.pi, math.tau) - math.pi
    return result


def twist_error(odom: Array, driven: DrivenTwist) -> dict[str, Any]:
    """How far the mean twist was from the one that was asked for, once settled.

    Args:
        odom: Rows of Recording.odom.
        driven: What was asked for.
    """
    since = odom[:, 0] - driven.start
    chosen = (since >= SETTLING) & (since <= driven.phase.duration)
    if not chosen.any():
        return {"name": driven.phase.name, "linear_m_s": math.inf, "angular_rad_s": math.inf}
    asked = np.array([driven.phase.twist(t) for t in since[chosen].tolist()])
    mean = (odom[chosen, 4:7] - asked).mean(axis=0)
    return {
        "name": driven.phase.name,
        "linear_m_s": math.hypot(mean[0], mean[1]),
        "angular_rad_s": abs(float(mean[2])),
    }


class Reference:
    """What `path/reference` asked for, as a function of ROS time.

    Args:
        rows: Stamp, x, y, theta, in any order, parts more than once; from Recording.reference.
    """

    def __init__(self, rows: Sequence[Row]) -> None:
        table = np.array(rows).reshape(-1, 4)
        table = table[np.argsort(table[:, 0], kind="stable")]
        fresh = np.concatenate([[True], np.diff(table[:, 0]) > SAME_TICK])[: len(table)]
        self.times = table[fresh, 0]
        self._poses = np.column_stack([table[fresh, 1:3], np.unwrap(table[fresh, 3])])

    def during(self, times: Array, legs: Sequence[DrivenLeg]) -> NDArray[np.bool_]:
        """Which of the times (k,) are in a leg and within the reference."""
        chosen = np.zeros(len(times), dtype=bool)
        if len(self.times):
            for leg in legs:
                chosen |= (times >= leg.start) & (times <= leg.end)
            chosen &= (times >= self.times[0]) & (times <= self.times[-1])
        return chosen

    def at(self, times: Array) -> Array:
        """Poses (k, 3) at times (k,), held before the first and after the last [m, m, rad]."""
        return np.column_stack([np.interp(times, self.times, pose) for pose in self._poses.T])


def tracking(odom: Array, reference: Reference, legs: Sequence[DrivenLeg]) -> dict[str, Any]:
    """Error in odom, at each message's stamp, against the reference of that instant.

    Args:
        odom: Rows of Recording.odom.
        reference: What was asked for.
        legs: When it was driven.
    """
    during = reference.during(odom[:, 0], legs)
    if not during.any():
        return dict.fromkeys(TRACKING, math.inf)
    distance, angle = pose_errors(odom[during], reference)
    ended = odom[:, 0] <= max(leg.end for leg in legs) + RESTING
    last, turn = pose_errors(odom[ended][-1:], reference)
    return {
        "rms_mm": 1e3 * rms(distance),
        "max_mm": 1e3 * float(distance.max()),
        "heading_rms_deg": math.degrees(rms(angle)),
        "heading_max_deg": math.degrees(float(np.abs(angle).max())),
        "final_mm": 1e3 * float(last[0]),
        "final_heading_deg": math.degrees(abs(float(turn[0]))),
        "samples": int(during.sum()),
    }


def pose_errors(odom: Array, reference: Reference) -> tuple[Array, Array]:
    """Distance [m] and angle [rad], (k,) each, of rows of Recording.odom from the reference."""
    off = odom[:, 1:4] - reference.at(odom[:, 0])
    return np.hypot(off[:, 0], off[:, 1]), wrapped(off[:, 2])


def coupling(rows: Sequence[Row], legs: Sequence[DrivenLeg]) -> dict[str, Any]:
    """Coupling error on the path, on the whole and for each movement [rad]."""
    table = np.array(rows)
    epsilon = table[:, 1:]
    result: dict[str, Any] = {"rms_rad": 0.0, "max_rad": 0.0, "movements": {}}
    if not epsilon.size:
        return result
    inside = np.zeros(len(table), dtype=bool)
    for leg in legs:
        during = (table[:, 0] >= leg.start) & (table[:, 0] <= leg.end)
        inside |= during
        if during.any():
            result["movements"][leg.name] = float(np.abs(epsilon[during]).max())
    if inside.any():
        result["rms_rad"] = rms(epsilon[inside])
        result["max_rad"] = float(np.abs(epsilon[inside]).max())
    return result


def drift(odom: Array, truth: Array) -> dict[str, Any]:
    """Odometry against the ground truth at the end, both seen from where they began.

    Args:
        odom, truth: Rows that begin with stamp, x, y, theta.
    """
    ours, true = _from_start(odom[:, 1:4]), _from_start(truth[:, 1:4])
    steps = np.diff(truth[:, 1:4], axis=0)
    return {
        "position_mm": 1e3 * float(np.hypot(*(ours[:2] - true[:2]))),
        "heading_deg": math.degrees(abs(float(wrapped(ours[2] - true[2])))),
        "travel_m": float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
        "turn_rad": float(np.abs(wrapped(steps[:, 2])).sum()),
    }


def _from_start(poses: Array) -> Array:
    x, y, turn = poses[-1] - poses[0]
    c, s = math.cos(poses[0, 2]), math.sin(poses[0, 2])
    return np.array([c * x + s * y, c * y - s * x, turn])


def goal_figures(odom: Array, driven: DrivenGoal, half: Sequence[float]) -> dict[str, Any]:
    """How near to the goal the robot came, and how near to the obstacles, which are in odom.

    Args:
        odom: Rows of Recording.odom.
        driven: The goal.
        half: Half length and half width of the robot's box [m].
    """
    during = odom[(odom[:, 0] >= driven.start) & (odom[:, 0] <= driven.end)]
    if not len(during):
        return dict.fromkeys(("position_mm", "heading_deg", "time_s"), math.inf) | {
            "clearance_m": -math.inf
        }
    last, goal = during[-1, 1:4], np.array(driven.goal)
    return {
        "position_mm": 1e3 * float(np.hypot(*(last[:2] - goal[:2]))),
        "heading_deg": math.degrees(abs(float(wrapped(last[2] - goal[2])))),
        "time_s": driven.end - driven.start,
        "clearance_m": float(driven.crossing.gaps(during[:, :4], half).min()),
    }


def intervals(arrivals: Sequence[float]) -> dict[str, Any]:
    """Rate [Hz] and interval [ms] of messages by their arrivals [s]."""
    gaps = 1e3 * np.diff(np.array(arrivals))
    return {
        "rate_hz": 1e3 / float(gaps.mean()),
        "p50_ms": float(np.percentile(gaps, 50)),
        "p99_ms": float(np.percentile(gaps, 99)),
        "max_ms": float(gaps.max()),
    }


def excuse(recording: Recording) -> str:
    """What the machine has to do with a failure, in brackets, or an empty string."""
    if recording.stall <= STALL:
        return ""
    return f" (this machine stood still for {recording.stall:.2f} s meanwhile: try again)"


def judge(
    recording: Recording,
    twists: Sequence[DrivenTwist],
    legs: Sequence[DrivenLeg],
    without_wheel: DrivenWithoutWheel | None = None,
    goal: DrivenGoal | None = None,
    half: Sequence[float] = (0.0, 0.0),
    moves: Sequence[ArmMove] = (),
    tool: ToolTrack | None = None,
    stop: DrivenStop | None = None,
) -> dict[str, Any]:
    """All figures, and under "faults" a sentence for each that is beyond its limit."""
    odom, truth = np.array(recording.odom), np.array(recording.truth)
    energy = np.array(recording.energy)
    result: dict[str, Any] = {
        "twists": [twist_error(odom, driven) for driven in twists],
        "tracking": tracking(odom, Reference(recording.reference), legs),
        "coupling": coupling(recording.coupling, legs),
        "odometry": drift(odom, truth),
        "energy": {
            "total_j": float((energy[-1] - energy[0]).sum()),
            "wheels_j": (energy[-1] - energy[0]).tolist(),
        },
        "timing": {
            "odom": intervals(recording.odom_arrivals),
            "wheel_commands": intervals(recording.command_arrivals),
        },
    }
    if goal is not None:
        result["goal"] = goal_figures(odom, goal, half)
    if moves:
        result["arm"] = arm_figures(recording, moves)
    if tool is not None:
        result["tool"] = tool_leg.figures(tool)
    if without_wheel is not None:
        result["dead_wheel"] = {
            "wheel": without_wheel.wheel,
            "noticed_s": without_wheel.noticed - without_wheel.lost,
            **tracking(odom, Reference(recording.reference), [without_wheel.leg]),
        }
    if stop is not None:
        result["emergency_stop"] = stop_leg.figures(recording, stop)
    result["timing"]["stall_ms"] = 1e3 * recording.stall
    result["faults"] = [fault + excuse(recording) for fault in faults(result)]
    return result


def arm_figures(recording: Recording, moves: Sequence[ArmMove]) -> dict[str, Any]:
    """How the arm followed, and where it came to rest, over all joints.

    The servo of the controller lags: the lag is the delay at which the measured angles fit the
    reference best, the error is what is left then.
    """
    measured = np.array(recording.arm)
    reference = np.array(recording.arm_reference).reshape(-1, measured.shape[1])
    reference = reference[np.argsort(reference[:, 0], kind="stable")]
    moving = np.zeros(len(measured), dtype=bool)
    final = []
    for move in moves:
        moving |= (measured[:, 0] >= move.start + SETTLING) & (measured[:, 0] <= move.end)
        last = measured[measured[:, 0] <= move.end][-1, 1:]
        final.append(float(np.abs(last - np.array(move.goal)).max()))
    rows = measured[moving]

    def error(lag: float) -> Array:
        columns = [
            np.interp(rows[:, 0] - lag, reference[:, 0], reference[:, k])
            for k in range(1, reference.shape[1])
        ]
        return rows[:, 1:] - np.column_stack(columns)

    lags = np.arange(-0.1, 0.2, 0.002)
    lag = float(lags[int(np.argmin([rms(error(x)) for x in lags]))])
    ways = np.abs(np.diff(rows[:, 1:], axis=0)).sum(axis=0)
    return {
        "moves": len(moves),
        "travel_rad": float(ways.max()),
        "final_mrad": 1e3 * max(final),
        "lag_ms": 1e3 * lag,
        "rms_mrad": 1e3 * rms(error(lag)),
        "setpoints": intervals(np.cumsum(recording.arm_intervals).tolist()),
    }


def faults(result: dict[str, Any]) -> list[str]:
    """A sentence for each figure that is beyond its limit."""
    track, odometry, timing = result["tracking"], result["odometry"], result["timing"]
    most = [
        ("tracking RMS, mm", track["rms_mm"]),
        ("tracking max, mm", track["max_mm"]),
        ("final position, mm", track["final_mm"]),
        ("final heading, deg", track["final_heading_deg"]),
        ("odometry position, mm", odometry["position_mm"]),
        ("odometry heading, deg", odometry["heading_deg"]),
    ]
    if "goal" in result:
        most.append(("goal position, mm", result["goal"]["position_mm"]))
        most.append(("goal heading, deg", result["goal"]["heading_deg"]))
    if "arm" in result:
        most.append(("arm final position, mrad", result["arm"]["final_mrad"]))
        most.append(("arm behind its reference, ms", abs(result["arm"]["lag_ms"])))
        most.append(("arm off its path, mrad", result["arm"]["rms_mrad"]))
    if "tool" in result:
        most.append(("tool off its path RMS, mm", result["tool"]["rms_mm"]))
        most.append(("tool off its path max, mm", result["tool"]["max_mm"]))
    if "dead_wheel" in result:
        dead = result["dead_wheel"]
        most.append(("dead wheel noticed, s", dead["noticed_s"]))
        most.append(("tracking without a wheel RMS, mm", dead["rms_mm"]))
    if "emergency_stop" in result:
        stop = result["emergency_stop"]
        most.append(("at rest after an emergency stop, s", stop["rest_s"]))
        most.append(("moved after the reset, mm", stop["moved_mm"]))
        if "arm_rest_s" in stop:
            most.append(("arm at rest after an emergency stop, s", stop["arm_rest_s"]))
            most.append(("arm moved after the reset, mrad", stop["arm_moved_mrad"]))
    for twist in result["twists"]:
        most.append(("twist error, m/s", twist["linear_m_s"]))
        most.append(("twist error, rad/s", twist["angular_rad_s"]))
    found = [
        f"{name}: {value:.3g}, at most {LIMITS[name]:g}"
        for name, value in most
        if not value <= LIMITS[name]
    ]
    if "goal" in result and not result["goal"]["clearance_m"] > 0.0:
        found.append(f"an obstacle was touched: clearance {result['goal']['clearance_m']:.3g} m")
    for topic in ("odom", "wheel_commands"):
        name = f"{topic} rate, Hz"
        rate = timing[topic]["rate_hz"]
        if not rate >= LIMITS[name]:
            found.append(f"{name}: {rate:.3g}, at least {LIMITS[name]:g}")
    return found
