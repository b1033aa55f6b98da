"""Findings: what the results of the experiments say about the papers' claims.

All functions are pure: they map the results' JSON to a finding.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from omniman_ros.lab.studies.coupling_sweep import AIM, PAPER_GAIN

Result = Mapping[str, Any]
Results = Mapping[str, Result]
"""The JSON of each experiment, by its name."""

PAPER_PLANNER = "the paper's horizon and cost"
"""Name of the drives with the paper's setting."""
VOLTAGES = "voltages put out"
"""Name of the drives with the paper's kind of output."""
DISTINGUISHABLE = 0.01
"""Change of epsilon by which a movement can be distinguished: some 20 steps of encoders with 50000
counts per turn [rad]."""
TURNED = math.radians(10.0)
"""Change of heading from which the robot counts as having rotated while it drives [rad]."""
STAGE = 0.1
"""Time that the paper's controller has for a plan, its Delta t [s]."""
SETPOINT_PERIOD = 8.0
"""Period of the arm's setpoints [ms]."""
SETPOINT_TOLERANCE = 0.1
"""Largest difference of the median period of the setpoints from `SETPOINT_PERIOD` [ms]."""


class Verdict(Enum):
    """The verdict of a comparison."""

    AGREES = "agrees"
    PARTLY = "partly"
    DIFFERS = "differs"
    SHOWN = "no number"
    MISSING = "not measured"

    @staticmethod
    def of(good: bool) -> "Verdict":
        """Return AGREES or DIFFERS."""
        return Verdict.AGREES if good else Verdict.DIFFERS

    @staticmethod
    def all_of(good: Sequence[bool]) -> "Verdict":
        """Return AGREES if all are good, PARTLY if some are, else DIFFERS.

        Raises:
            LookupError: There is nothing to judge.
        """
        if not good:
            raise LookupError("nothing to judge")
        if all(good):
            return Verdict.AGREES
        return Verdict.PARTLY if any(good) else Verdict.DIFFERS


@dataclass(frozen=True)
class Finding:
    """A finding: what was measured, and how that compares with what is published.

    Attributes:
        values: Measured values, with their units in their names.
        text: The values in words.
        verdict: Verdict of the comparison.
    """

    values: Mapping[str, Any]
    text: str
    verdict: Verdict = Verdict.SHOWN


def row(result: Result, group: str, gain: float) -> Result:
    """Return the figures of the coupling study for a group of wheels and a gain."""
    return _only(result["table"], lambda item: (item["group"], item["k"]) == (group, gain))


def drive(result: Result, about: str = "defaults") -> Result:
    """Return the drive of a case with a setting."""
    return _only(result["drives"], lambda item: item["about"] == about)


def _only(items: Sequence[Result], which: Callable[[Result], bool]) -> Result:
    """Return the first item for which a condition holds."""
    matches = [item for item in items if which(item)]
    return matches[0]


def _clear(ride: Result) -> bool:
    """Return whether a drive reached its goal without a collision."""
    return bool(ride["reached"] and not ride["collided"])


# ---- CCTA 2017 ----------------------------------------------------------------------------------


def uncontrolled(results: Results) -> Finding:
    """Judge the coupling error without control, as a whole and in each movement."""
    study = results["coupling"]
    largest = row(study, "P", 0.0)["epsilon_max"]["mean"]
    peaks = list(study["uncontrolled_rad"].values())
    seen = [peak >= DISTINGUISHABLE for peak in peaks]
    return Finding(
        {"epsilon_max_rad": largest, "movement_rad": peaks},
        f"max |ε| {largest:.2f} rad; within a movement {min(peaks):.2f} to {max(peaks):.2f} rad, "
        f"{sum(seen)} of {len(seen)} stand out",
        Verdict.all_of(seen),
    )


def remaining(group: str, own: bool) -> Callable[[Results], Finding]:
    """Judge the share of the coupling error that remains with control.

    Args:
        group: Group of wheels.
        own: Whether the gain is the robot's own, instead of the paper's.
    """

    def measure(results: Results) -> Finding:
        study = results["coupling"]
        gain = study["chosen_gain"] if own else PAPER_GAIN
        here = row(study, group, gain)
        mean, worst = here["epsilon_ratio"]["mean"], here["epsilon_ratio"]["worst"]
        return Finding(
            {"k": gain, "ratio": mean, "worst": worst},
            f"{mean:.2f} of it stays at k = {gain:g} (worst wheels {worst:.2f}): "
            f"{here['epsilon_max']['mean']:.2f} rad",
            Verdict.of(mean <= AIM),
        )

    return measure


def slip(results: Results) -> Finding:
    """Judge the slip losses without control and with the paper's gain."""
    off, on = (row(results["coupling"], "P", gain) for gain in (0.0, PAPER_GAIN))
    before, after = off["slip"]["mean"], on["slip"]["mean"]
    return Finding(
        {"off_j": before, "on_j": after},
        f"slip losses {before:.1f} J without control, {after:.1f} J at k = {PAPER_GAIN:g}",
        Verdict.of(after < before),
    )


def odometry(results: Results) -> Finding:
    """Judge the largest error of odometry without control and with the paper's gain."""
    study = results["coupling"]
    groups = dict.fromkeys(item["group"] for item in study["table"])
    words = {"P": "P loops", "PI": "PI loops", "radii": "radii off", "ice": "ice"}
    values, said, better = {}, [], []
    for group in groups:
        before, after = (
            1e3 * row(study, group, gain)["odometry_max"]["mean"] for gain in (0.0, PAPER_GAIN)
        )
        values[group] = [before, after]
        said.append(f"{words.get(group, group)} {before:.1f} → {after:.1f} mm")
        better.append(after < before)
    return Finding({"mm": values}, ", ".join(said), Verdict.all_of(better))


def in_step(results: Results) -> Finding:
    """Measure the distance of the tool from its timed path, platform and arm in step."""
    study = results["tool_path"]
    rides = [ride for ride in study["drives"] if ride["correction"]]
    rms, most = (max(ride[name] for ride in rides) for name in ("rms_mm", "max_mm"))
    bounds = study["bounds"]
    return Finding(
        {"rms_mm": rms, "max_mm": most},
        f"tool off its timed path by {rms:.2f} mm RMS, {most:.2f} mm at most "
        f"(own bounds {bounds['rms_mm']:g} and {bounds['max_mm']:g} mm)",
    )


def setpoints(name: str, *path: str) -> Callable[[Results], Finding]:
    """Judge the interval of the arm's setpoints.

    Args:
        name: Name of the result.
        path: Keys of the figures in the result.
    """

    def measure(results: Results) -> Finding:
        found = results[name]
        for key in path:
            found = found[key]
        p50, p99 = found["p50_ms"], found["p99_ms"]
        return Finding(
            {"p50_ms": p50, "p99_ms": p99},
            f"median {p50:.2f} ms, p99 {p99:.2f} ms",
            Verdict.of(abs(p50 - SETPOINT_PERIOD) <= SETPOINT_TOLERANCE),
        )

    return measure


# ---- MPC 2021 -----------------------------------------------------------------------------------

CASES = ("free", "corridor", "moving")
"""Experiments that are cases of the paper."""


def in_time(about: str) -> Callable[[Results], Finding]:
    """Judge the CPU time of a planner's cycle: the largest p99 of the three cases."""

    def measure(results: Results) -> Finding:
        rides = [drive(results[name], about) for name in CASES]
        middle = max(ride["cpu_median_ms"] for ride in rides)
        high = max(ride["cpu_p99_ms"] for ride in rides)
        return Finding(
            {"median_ms": middle, "p99_ms": high},
            f"CPU of a cycle: median {middle:.1f} ms, p99 {high:.1f} ms, the worst of three cases",
            Verdict.of(high < 1e3 * STAGE),
        )

    return measure


def arrives(about: str) -> Callable[[Results], Finding]:
    """Judge whether the robot reaches the goal in all three cases without contact."""

    def measure(results: Results) -> Finding:
        rides = {name: drive(results[name], about) for name in CASES}
        good = {name: _clear(ride) for name, ride in rides.items()}
        times = ", ".join(
            f"{name} {ride['time_s']:.1f} s" if good[name] else f"{name} FAILED"
            for name, ride in rides.items()
        )
        return Finding(good, times, Verdict.all_of(list(good.values())))

    return measure


def duration(results: Results) -> Finding:
    """Measure the time of the free case."""
    ride = drive(results["free"])
    return Finding(
        {"time_s": ride["time_s"], "energy_j": ride["energy_j"]},
        f"{ride['time_s']:.1f} s, {ride['energy_j']:.0f} J for 6 m",
    )


def along_diagonal(about: str) -> Callable[[Results], Finding]:
    """Judge whether the robot rotates on free ground, and drives along a roller diagonal."""

    def measure(results: Results) -> Finding:
        ride = drive(results["free"], about)
        turned = ride["peak_turn_rad"]
        return Finding(
            {"turned_rad": turned, "share": ride["share"]},
            f"turns by {math.degrees(turned):.0f}°, near a diagonal in "
            f"{100 * ride['share']:.0f} % of the time",
            Verdict.all_of([turned >= TURNED, ride["along_diagonal"]]),
        )

    return measure


def economy(results: Results) -> Finding:
    """Judge the energy over that of a straight line in one heading, at the same arrival time."""
    rows = [item for item in results["free"]["energy"] if item["ratio"] is not None]
    ratios = [item["ratio"] for item in rows]
    least, most = min(ratios), max(ratios)
    less = sum(ratio < 1.0 for ratio in ratios)
    return Finding(
        {"ratios": ratios},
        f"{least:.2f} to {most:.2f} of a straight line's energy; less for {less} of "
        f"{len(ratios)} goals",
        Verdict.all_of([ratio < 1.0 for ratio in ratios]),
    )


def passage(results: Results) -> Finding:
    """Judge whether and how the robot passes the gap that is narrower than the robot is long."""
    ride = drive(results["corridor"])
    turned = ride["peak_turn_rad"]
    return Finding(
        {"turned_rad": turned, "clearance_m": ride["clearance_m"]},
        f"through, turned by up to {math.degrees(turned):.0f}°, least gap "
        f"{1e3 * ride['clearance_m']:.0f} mm"
        if _clear(ride)
        else "not through without contact",
        Verdict.all_of([_clear(ride), turned >= TURNED]) if _clear(ride) else Verdict.DIFFERS,
    )


def in_reverse(results: Results) -> Finding:
    """Judge whether a part of the path through the corridor is driven backwards."""
    share = drive(results["corridor"])["backwards_share"]
    return Finding(
        {"share": share}, f"{100 * share:.0f} % of the way is backwards", Verdict.of(share > 0.0)
    )


def evasion(results: Results) -> Finding:
    """Judge whether the robot passes moving obstacles, one of which changes its velocity."""
    ride = drive(results["moving"])
    good = _clear(ride)
    return Finding(
        {"time_s": ride["time_s"], "clearance_m": ride["clearance_m"]},
        f"past all four, least gap {1e3 * ride['clearance_m']:.0f} mm, {ride['plans_used']} of "
        f"{ride['cycles']} plans used"
        if good
        else "not past without contact",
        Verdict.of(good),
    )


def inexact(results: Results) -> Finding:
    """Judge the random scenes with a robot that differs from its model."""
    group = results["scenes"]["groups"]["model off by up to 20 %"]
    touched = group["own_collisions"] + group["other_collisions"]
    return Finding(
        {"drives": group["drives"], "reached": group["reached"], "contacts": touched},
        f"{group['reached']} of {group['drives']} goals reached, {touched} contacts",
        Verdict.of(group["own_collisions"] == 0 and group["reached"] >= group["solvable"]),
    )


def friction(results: Results) -> Finding:
    """Return the identified viscous and Coulomb friction of the wheels."""
    wheels = results["identify_friction"]["wheels"]
    a, b = ([wheel[name]["value"] for wheel in wheels] for name in ("viscous", "coulomb"))
    return Finding(
        {"viscous": a, "coulomb": b},
        f"a {min(a):.3f} to {max(a):.3f} N m s, b {min(b):.2f} to {max(b):.2f} N m",
    )


def rooms(results: Results) -> Finding:
    """Return the time and the least gap of the drive through the workshop."""
    ride = drive(results["workshop"])
    return Finding(
        {"time_s": ride["time_s"], "clearance_m": ride["clearance_m"]},
        f"out of a dead end and through three doors in {ride['time_s']:.0f} s, least gap "
        f"{1e3 * ride['clearance_m']:.0f} mm"
        if _clear(ride)
        else "not reached without contact",
    )
