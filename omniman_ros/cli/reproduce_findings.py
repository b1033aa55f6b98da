"""What the results of the experiments say to a claim of the papers, as pure functions."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from omniman_ros.studies.coupling_sweep import AIM, PAPER_GAIN

Result = Mapping[str, Any]
Results = Mapping[str, Result]
"""The JSON of each experiment, by its name."""

PAPER_PLANNER, VOLTAGES = "the paper's horizon and cost", "voltages put out"
"""How the drives with the paper's own setting, and with its kind of output, are called."""
TOLD_APART = 0.01
"""A movement that changes epsilon by this much can be told apart: some 20 steps of the encoders,
of 50000 counts a turn [rad]."""
TURNED = math.radians(10.0)
"""From here on the heading is said to have changed on the way [rad]."""
STAGE = 0.1
"""What the paper's controller has for a plan, its Delta t [s]."""
SETPOINT, SETPOINT_ROOM = 8.0, 0.1
"""Period of the arm's setpoints, and how far off their median may be [ms]."""


class Verdict(Enum):
    """What a comparison says."""

    AGREES = "agrees"
    PARTLY = "partly"
    DIFFERS = "differs"
    SHOWN = "no number"
    MISSING = "not measured"

    @staticmethod
    def of(good: bool) -> "Verdict":
        """Agrees or differs."""
        return Verdict.AGREES if good else Verdict.DIFFERS

    @staticmethod
    def all_of(good: Sequence[bool]) -> "Verdict":
        """Agrees if all are good, partly if some are; raises LookupError if there is none."""
        if not good:
            raise LookupError("nothing to judge")
        if all(good):
            return Verdict.AGREES
        return Verdict.PARTLY if any(good) else Verdict.DIFFERS


@dataclass(frozen=True)
class Finding:
    """What was measured: values, their units in their names, a text, and what that says."""

    values: Mapping[str, Any]
    text: str
    verdict: Verdict = Verdict.SHOWN


def row(result: Result, group: str, gain: float) -> Result:
    """Figures of the coupling study for a group of wheels and a gain."""
    return _only(result["table"], lambda item: (item["group"], item["k"]) == (group, gain))


def drive(result: Result, about: str = "defaults") -> Result:
    """The drive of a case with a setting."""
    return _only(result["drives"], lambda item: item["about"] == about)


def _only(items: Sequence[Result], which: Callable[[Result], bool]) -> Result:
    found = [item for item in items if which(item)]
    return found[0]


def _clear(ride: Result) -> bool:
    return bool(ride["reached"] and not ride["collided"])


# ---- CCTA 2017 ----------------------------------------------------------------------------------


def uncontrolled(results: Results) -> Finding:
    """Coupling error without control, as a whole and in each movement."""
    study = results["coupling"]
    largest = row(study, "P", 0.0)["epsilon_max"]["mean"]
    peaks = list(study["uncontrolled_rad"].values())
    seen = [peak >= TOLD_APART for peak in peaks]
    return Finding(
        {"epsilon_max_rad": largest, "movement_rad": peaks},
        f"max |ε| {largest:.2f} rad; within a movement {min(peaks):.2f} to {max(peaks):.2f} rad, "
        f"{sum(seen)} of {len(seen)} stand out",
        Verdict.all_of(seen),
    )


def remaining(group: str, own: bool) -> Callable[[Results], Finding]:
    """Share of the coupling error that stays under control, with the paper's gain or our own."""

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
    """Slip losses without control and with the paper's gain."""
    off, on = (row(results["coupling"], "P", gain) for gain in (0.0, PAPER_GAIN))
    before, after = off["slip"]["mean"], on["slip"]["mean"]
    return Finding(
        {"off_j": before, "on_j": after},
        f"slip losses {before:.1f} J without control, {after:.1f} J at k = {PAPER_GAIN:g}",
        Verdict.of(after < before),
    )


def odometry(results: Results) -> Finding:
    """Largest error of odometry without control and with the paper's gain, by kind of wheels."""
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
    """How far the tool is off its timed path when platform and arm move in step."""
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
    """Interval of the arm's setpoints in a result."""

    def measure(results: Results) -> Finding:
        found = results[name]
        for key in path:
            found = found[key]
        p50, p99 = found["p50_ms"], found["p99_ms"]
        return Finding(
            {"p50_ms": p50, "p99_ms": p99},
            f"median {p50:.2f} ms, p99 {p99:.2f} ms",
            Verdict.of(abs(p50 - SETPOINT) <= SETPOINT_ROOM),
        )

    return measure


# ---- MPC 2021 -----------------------------------------------------------------------------------

CASES = ("free", "corridor", "moving")


def in_time(about: str) -> Callable[[Results], Finding]:
    """CPU time of a planner's cycle, the largest p99 of the three cases."""

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
    """Whether the robot gets to the goal in all three cases, and touches nothing."""

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
    """Time of the free case."""
    ride = drive(results["free"])
    return Finding(
        {"time_s": ride["time_s"], "energy_j": ride["energy_j"]},
        f"{ride['time_s']:.1f} s, {ride['energy_j']:.0f} J for 6 m",
    )


def along_diagonal(about: str) -> Callable[[Results], Finding]:
    """Whether the robot turns on a free way, and travels along a diagonal of its rollers."""

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
    """Energy over that of a straight line in one heading, at the same arrival time."""
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
    """Whether and how the robot gets through the gap that is narrower than it is long."""
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
    """How much of the way through the corridor is driven backwards."""
    share = drive(results["corridor"])["backwards_share"]
    return Finding(
        {"share": share}, f"{100 * share:.0f} % of the way is backwards", Verdict.of(share > 0.0)
    )


def evasion(results: Results) -> Finding:
    """Whether the robot gets past obstacles that move, one of which changes its velocity."""
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
    """Random scenes with a robot that is not as its model says."""
    group = results["scenes"]["groups"]["model off by up to 20 %"]
    touched = group["own_collisions"] + group["other_collisions"]
    return Finding(
        {"drives": group["drives"], "reached": group["reached"], "contacts": touched},
        f"{group['reached']} of {group['drives']} goals reached, {touched} contacts",
        Verdict.of(group["own_collisions"] == 0 and group["reached"] >= group["solvable"]),
    )


def friction(results: Results) -> Finding:
    """Viscous and Coulomb friction found by turning the wheels."""
    wheels = results["identify_friction"]["wheels"]
    a, b = ([wheel[name]["value"] for wheel in wheels] for name in ("viscous", "coulomb"))
    return Finding(
        {"viscous": a, "coulomb": b},
        f"a {min(a):.3f} to {max(a):.3f} N m s, b {min(b):.2f} to {max(b):.2f} N m",
    )


def rooms(results: Results) -> Finding:
    """The workshop of three rooms."""
    ride = drive(results["workshop"])
    return Finding(
        {"time_s": ride["time_s"], "clearance_m": ride["clearance_m"]},
        f"out of a dead end and through three doors in {ride['time_s']:.0f} s, least gap "
        f"{1e3 * ride['clearance_m']:.0f} mm"
        if _clear(ride)
        else "not reached without contact",
    )
