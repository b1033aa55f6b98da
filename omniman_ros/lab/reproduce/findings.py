"""Findings: evaluation of the experiments' results with regard to the papers' claims.

All functions are pure: they map the JSON of the results to a :class:`Finding`. They raise a
`LookupError`, `TypeError` or `ValueError` if a value that they need is missing from the results.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from omniman_ros.lab.studies.coupling import OWN_CONTROLLER, PAPER_CONTROLLER
from omniman_ros.lab.studies.coupling_sweep import AIM, PAPER_GAIN

Result = Mapping[str, Any]
"""The JSON of one experiment, or a part of it."""
Results = Mapping[str, Result]
"""The JSON of all experiments, by the name of the experiment."""

PAPER_HORIZON = "the paper's horizon"
"""Description (`about`) of the planner's drives with the horizon of MPC 2021."""
VOLTAGES = "voltages put out"
"""Description (`about`) of the drives in which the planner's motor voltages are applied."""
DISTINGUISHABLE = 0.01
"""Smallest change of the coupling error epsilon within a movement that counts as distinguishable
[rad]: about 80 counts of one wheel's encoder with 50000 counts per turn."""
MIN_TURN = math.radians(10.0)
"""Smallest change of heading that counts as a rotation of the robot during a drive [rad]."""
STAGE_DURATION = 0.1
"""Duration of a stage in MPC 2021 (Delta t), within which a plan must be computed [s]."""
SETPOINT_PERIOD = 8.0
"""Period of the arm's setpoints in CCTA 2017 [ms]."""
SETPOINT_TOLERANCE = 0.1
"""Largest accepted difference of the median interval from `SETPOINT_PERIOD` [ms]."""


class Verdict(Enum):
    """Verdict of the comparison of a measurement with a claim.

    UNLIKE: the conditions are not the paper's, so that neither agreement nor difference can be
    stated. SHOWN: the paper gives nothing to compare with. MISSING: there is no measurement.
    """

    AGREES = "agrees"
    PARTLY = "partly"
    DIFFERS = "differs"
    UNLIKE = "not like for like"
    SHOWN = "no number"
    MISSING = "not measured"

    @staticmethod
    def of(good: bool) -> "Verdict":
        """Return AGREES for True, DIFFERS for False."""
        return Verdict.AGREES if good else Verdict.DIFFERS

    @staticmethod
    def all_of(good: Sequence[bool]) -> "Verdict":
        """Return AGREES if all values are True, PARTLY if some are, else DIFFERS.

        Raises:
            LookupError: There are no values.
        """
        if not good:
            raise LookupError("nothing to judge")
        if all(good):
            return Verdict.AGREES
        return Verdict.PARTLY if any(good) else Verdict.DIFFERS


@dataclass(frozen=True)
class Finding:
    """A measurement and its comparison with a published claim.

    Attributes:
        values: Measured values, with their units in their names.
        text: Measured values as a phrase for the report.
        verdict: Verdict of the comparison.
    """

    values: Mapping[str, Any]
    text: str
    verdict: Verdict = Verdict.SHOWN


def find_row(result: Result, group: str, gain: float, controller: str = OWN_CONTROLLER) -> Result:
    """Return the row of the coupling study for a group, a gain [1/s] and a controller."""
    key = (group, gain, controller)
    return _first(
        result["table"], lambda item: (item["group"], item["k"], item["controller"]) == key
    )


def find_printed(result: Result, group: str) -> Result:
    """Return the row of the coupling study for the paper's controller with (18) as printed."""
    return find_row(result, group, result["printed_gain"], PAPER_CONTROLLER)


def find_drive(result: Result, about: str = "defaults") -> Result:
    """Return the drive of a case with the given description."""
    return _first(result["drives"], lambda item: item["about"] == about)


def _first(items: Sequence[Result], condition: Callable[[Result], bool]) -> Result:
    """Return the first item that satisfies a condition.

    Raises:
        LookupError: No item does.
    """
    matches = [item for item in items if condition(item)]
    return matches[0]


def _succeeded(drive: Result) -> bool:
    """Return whether a drive reached its goal without a collision."""
    return bool(drive["reached"] and not drive["collided"])


# ---- CCTA 2017 ----------------------------------------------------------------------------------


def uncontrolled_error(results: Results) -> Finding:
    """Judge whether each movement changes the coupling error noticeably without control."""
    study = results["coupling"]
    largest = find_row(study, "P", 0.0)["epsilon_max"]["mean"]
    peaks = list(study["uncontrolled_rad"].values())
    distinguishable = [peak >= DISTINGUISHABLE for peak in peaks]
    return Finding(
        {"epsilon_max_rad": largest, "movement_rad": peaks},
        f"max |ε| {largest:.2f} rad; within a movement {min(peaks):.2f} to {max(peaks):.2f} rad, "
        f"{sum(distinguishable)} of {len(distinguishable)} distinguishable",
        Verdict.all_of(distinguishable),
    )


def remaining_as_printed(group: str) -> Callable[[Results], Finding]:
    """Return a function that judges what remains with the paper's equations as printed.

    Args:
        group: Group of drives in the coupling study, such as "P".
    """

    def measure(results: Results) -> Finding:
        found = find_printed(results["coupling"], group)
        mean, worst = found["epsilon_ratio"]["mean"], found["epsilon_ratio"]["worst"]
        return Finding(
            {"k": PAPER_GAIN, "acts_like": found["k"], "ratio": mean, "worst": worst},
            f"{mean:.3f} of it remains (worst wheels {worst:.3f}): "
            f"{found['epsilon_max']['mean']:.3f} rad; the rule allows {AIM / mean:.1f} times that",
            Verdict.of(mean <= AIM),
        )

    return measure


def remaining_corrected(results: Results) -> Finding:
    """Judge what remains with the paper's gain and controller, but J_a corrected."""
    study = results["coupling"]
    groups = [
        item["group"]
        for item in study["table"]
        if (item["controller"], item["k"]) == (PAPER_CONTROLLER, PAPER_GAIN)
        and item["group"] in ("P", "PI")
    ]
    rows = {group: find_row(study, group, PAPER_GAIN, PAPER_CONTROLLER) for group in groups}
    ratios = {group: row["epsilon_ratio"]["mean"] for group, row in rows.items()}
    return Finding(
        {"k": PAPER_GAIN, "ratio": ratios},
        ", ".join(
            f"{group} loops: {ratios[group]:.2f} of it remains, "
            f"{row['epsilon_max']['mean']:.2f} rad"
            for group, row in rows.items()
        ),
        Verdict.all_of([ratio <= AIM for ratio in ratios.values()]),
    )


def remaining_own(results: Results) -> Finding:
    """Judge what remains with this package's controller at the robot's own gain, P loops."""
    study = results["coupling"]
    gain = study["chosen_gain"]
    found = find_row(study, "P", gain)
    mean, worst = found["epsilon_ratio"]["mean"], found["epsilon_ratio"]["worst"]
    return Finding(
        {"k": gain, "ratio": mean, "worst": worst},
        f"{mean:.2f} of it remains at k = {gain:g} (worst wheels {worst:.2f}): "
        f"{found['epsilon_max']['mean']:.2f} rad",
        Verdict.of(mean <= AIM),
    )


def slip_losses(results: Results) -> Finding:
    """Judge whether control by the paper's equations as printed reduces the slip losses."""
    study = results["coupling"]
    before = find_row(study, "P", 0.0)["slip"]["mean"]
    after = find_printed(study, "P")["slip"]["mean"]
    return Finding(
        {"off_j": before, "on_j": after},
        f"slip losses {before:.1f} J without control, {after:.1f} J with it",
        Verdict.of(after < before),
    )


LOOP_GROUPS = ("P", "PI")
"""Groups of drives whose wheels differ in what the paper names: friction, motors, amplifiers."""


def odometry_error(results: Results) -> Finding:
    """Judge whether control by the paper's equations reduces the largest error of odometry.

    Groups with other causes of error than the paper names are shown, and not judged.
    """
    study = results["coupling"]
    groups = dict.fromkeys(item["group"] for item in study["table"])
    labels = {
        "P": "P loops",
        "PI": "PI loops",
        "radii": "radius errors",
        "ice": "ice",
        "late": "late commands",
    }
    values, texts, improved = {}, [], []
    for group in groups:
        before = 1e3 * find_row(study, group, 0.0)["odometry_max"]["mean"]
        after = 1e3 * find_printed(study, group)["odometry_max"]["mean"]
        values[group] = [before, after]
        texts.append(f"{labels.get(group, group)} {before:.1f} → {after:.1f} mm")
        if group in LOOP_GROUPS:
            improved.append(after < before)
    return Finding({"mm": values}, ", ".join(texts), Verdict.all_of(improved))


def tool_tracking(results: Results) -> Finding:
    """Return the tracking error of the tool while platform and arm move together."""
    study = results["tool_path"]
    corrected = [drive for drive in study["drives"] if drive["correction"]]
    rms, largest = (max(drive[name] for drive in corrected) for name in ("rms_mm", "max_mm"))
    bounds = study["bounds"]
    return Finding(
        {"rms_mm": rms, "max_mm": largest},
        f"tracking error of the tool {rms:.2f} mm RMS, {largest:.2f} mm at most "
        f"(own bounds {bounds['rms_mm']:g} and {bounds['max_mm']:g} mm)",
    )


def side_by_side(results: Results) -> Finding:
    """Return the errors with which one robot keeps a station beside another one in motion."""
    study = results["handover"]
    judged = [drive for drive in study["drives"] if drive["is_aim"]]
    largest, heading = (
        max(drive[name] for drive in judged) for name in ("max_mm", "heading_max_deg")
    )
    gap = min(drive["least_gap_m"] for drive in judged)
    bounds = study["bounds"]
    return Finding(
        {"max_mm": largest, "heading_max_deg": heading, "least_gap_m": gap},
        f"station kept for {study['kept_s']:g} s beside a robot at {study['speed_m_s']:g} m/s: "
        f"true error {largest:.1f} mm and {heading:.2f} degrees at most (own bounds "
        f"{bounds['position_mm']:g} mm, {bounds['heading_deg']:g} degree), least gap {gap:.2f} m "
        f"on {len(judged)} drives",
    )


def setpoint_interval(name: str, *path: str) -> Callable[[Results], Finding]:
    """Return a function that judges the interval between the arm's setpoints.

    Args:
        name: Name of the result.
        path: Keys that lead to the statistics (`p50_ms`, `p99_ms`) within the result.
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
"""Experiments that reproduce the test cases of MPC 2021."""


def planning_time(about: str) -> Callable[[Results], Finding]:
    """Return a function that judges the CPU time of a planner cycle.

    The largest p99 of the three cases must be below the duration of a stage.

    Args:
        about: Description of the drives.
    """

    def measure(results: Results) -> Finding:
        drives = [find_drive(results[name], about) for name in CASES]
        median = max(drive["cpu_median_ms"] for drive in drives)
        p99 = max(drive["cpu_p99_ms"] for drive in drives)
        return Finding(
            {"median_ms": median, "p99_ms": p99},
            f"CPU time of a cycle: median {median:.1f} ms, p99 {p99:.1f} ms, worst of three cases",
            Verdict.of(p99 < 1e3 * STAGE_DURATION),
        )

    return measure


def goals_reached(about: str) -> Callable[[Results], Finding]:
    """Return a function that judges whether the goals of all three cases are reached.

    A drive with a contact does not count as reaching its goal.

    Args:
        about: Description of the drives.
    """

    def measure(results: Results) -> Finding:
        drives = {name: find_drive(results[name], about) for name in CASES}
        succeeded = {name: _succeeded(drive) for name, drive in drives.items()}
        times = ", ".join(
            f"{name} {drive['time_s']:.1f} s" if succeeded[name] else f"{name} FAILED"
            for name, drive in drives.items()
        )
        return Finding(succeeded, times, Verdict.all_of(list(succeeded.values())))

    return measure


def free_duration(results: Results) -> Finding:
    """Return the duration and the energy of the free case."""
    drive = find_drive(results["free"])
    return Finding(
        {"time_s": drive["time_s"], "energy_j": drive["energy_j"]},
        f"{drive['time_s']:.1f} s, {drive['energy_j']:.0f} J for 6 m",
    )


def diagonal_travel(about: str) -> Callable[[Results], Finding]:
    """Return a function that judges the rotation and the direction of travel without obstacles.

    The robot should rotate, and travel along a roller diagonal most of the time.

    Args:
        about: Description of the drive.
    """

    def measure(results: Results) -> Finding:
        drive = find_drive(results["free"], about)
        turned = drive["peak_turn_rad"]
        return Finding(
            {"turned_rad": turned, "share": drive["share"]},
            f"turns by {math.degrees(turned):.0f}°, near a diagonal for "
            f"{100 * drive['share']:.0f} % of the time",
            Verdict.all_of([turned >= MIN_TURN, drive["along_diagonal"]]),
        )

    return measure


def energy_ratio(results: Results) -> Finding:
    """Judge whether the planner needs less energy than a straight line with a constant heading.

    Both arrive at the same time.
    """
    ratios = [row["ratio"] for row in results["free"]["energy"] if row["ratio"] is not None]
    savings = sum(ratio < 1.0 for ratio in ratios)
    return Finding(
        {"ratios": ratios},
        f"{min(ratios):.2f} to {max(ratios):.2f} of a straight line's energy; "
        f"less for {savings} of {len(ratios)} goals",
        Verdict.all_of([ratio < 1.0 for ratio in ratios]),
    )


LATE_SHARE = 0.1
"""Largest share of the path that is left for the last part of a drive that slows down [-]."""
NEAR_GOAL = 0.05
"""Largest distance from the goal at rest, as a share of that at the start [-]."""
TURNED_BACK = math.radians(5.0)
"""Largest heading error at rest of a robot that has turned back [rad]."""


def _weight_rows(results: Results) -> list[Result]:
    """Return the drives with the paper's problem in which only the weights differ."""
    rows = [row for row in results["free_paper"]["drives"] if row["about"] == "weights"]
    return sorted(rows, key=lambda row: -float(row["w_pos"]))


def _by_weight(rows: Sequence[Result], texts: Sequence[str]) -> str:
    """Return the texts of drives, each after its W_pos."""
    pairs = zip(rows, texts, strict=True)
    return "W_pos " + ", ".join(f"{row['w_pos']:g}: {text}" for row, text in pairs)


def speed_profile(results: Results) -> Finding:
    """Judge whether the robot is fast at first and slow near the goal, with each weight."""
    rows = _weight_rows(results)
    peaks = [row["peak_speed_s"] / row["rest_s"] for row in rows]
    rest = [1.0 - row["way_shares"][-1] for row in rows]
    texts = [
        f"{row['peak_speed_m_s']:.1f} m/s at {row['peak_speed_s']:.1f} of {row['rest_s']:.1f} s"
        for row in rows
    ]
    return Finding(
        {"peak_shares": peaks, "late_shares": rest},
        f"{_by_weight(rows, texts)}; {100 * min(rest):.0f} to {100 * max(rest):.0f} % of the path "
        "in the last 2/9 of the time",
        Verdict.all_of(
            [peak < 0.5 and late <= LATE_SHARE for peak, late in zip(peaks, rest, strict=True)]
        ),
    )


def paper_heading(results: Results) -> Finding:
    """Judge whether the robot turns to a diagonal, travels along it and turns back."""
    rows = _weight_rows(results)
    judged = [
        [
            row["turn_to_diagonal_rad"] >= MIN_TURN,
            row["along_diagonal"],
            row["rest_rad"] <= TURNED_BACK,
        ]
        for row in rows
    ]
    texts = [
        f"{math.degrees(row['turn_to_diagonal_rad']):.0f}°, {100 * row['share']:.0f} %, "
        f"{math.degrees(row['rest_rad']):.0f}°"
        for row in rows
    ]
    return Finding(
        {
            name: [row[name] for row in rows]
            for name in ("w_pos", "turn_to_diagonal_rad", "share", "rest_rad")
        },
        f"turn to the diagonal, time near it, rest of the turn: {_by_weight(rows, texts)}",
        Verdict.all_of([condition for conditions in judged for condition in conditions]),
    )


def paper_goal(results: Results) -> Finding:
    """Judge whether the robot comes to rest at the goal, with each weight."""
    rows = _weight_rows(results)
    near = [row["rest_m"] <= NEAR_GOAL * row["goal_m"] for row in rows]
    return Finding(
        {name: [row[name] for row in rows] for name in ("w_pos", "rest_m", "rest_s")},
        "at rest short of it: " + _by_weight(rows, [f"{row['rest_m']:.2f} m" for row in rows]),
        Verdict.all_of(near),
    )


def paper_energy(results: Results) -> Finding:
    """Judge whether turning saves energy over the same path, without taking longer."""
    drives = results["free_paper"]["drives"]
    held = _first(drives, lambda row: row["about"] == "heading held")
    free = _first(drives, lambda row: row["about"] == "weights" and row["w_pos"] == held["w_pos"])
    pairs = [(row["compared_j"], row["compared_s"]) for row in (free, held)]
    (energy, time), (held_energy, held_time) = pairs
    way = results["free_paper"]["compared_way_m"]
    return Finding(
        {"free": pairs[0], "held": pairs[1]},
        f"{energy:.0f} J in {time:.2f} s for {way:g} m; with the heading held by W_ang = "
        f"{held['w_ang']:g} {held_energy:.0f} J in {held_time:.2f} s",
        Verdict.of(energy < held_energy and time <= held_time),
    )


def corridor_passage(results: Results) -> Finding:
    """Judge whether the robot passes the gaps narrower than its length, and turns for that."""
    drive = find_drive(results["corridor"])
    turned = drive["peak_turn_rad"]
    return Finding(
        {"turned_rad": turned, "clearance_m": drive["clearance_m"]},
        f"passed, turned by up to {math.degrees(turned):.0f}°, least gap "
        f"{1e3 * drive['clearance_m']:.0f} mm"
        if _succeeded(drive)
        else "not passed without contact",
        Verdict.all_of([_succeeded(drive), turned >= MIN_TURN])
        if _succeeded(drive)
        else Verdict.DIFFERS,
    )


def backward_travel(results: Results) -> Finding:
    """Judge whether the robot drives backwards for a part of the corridor."""
    share = find_drive(results["corridor"])["backwards_share"]
    return Finding(
        {"share": share}, f"backwards for {100 * share:.0f} % of the time", Verdict.of(share > 0.0)
    )


def moving_obstacles(results: Results) -> Finding:
    """Judge whether the robot passes moving obstacles, one of which changes its velocity."""
    drive = find_drive(results["moving"])
    succeeded = _succeeded(drive)
    return Finding(
        {"time_s": drive["time_s"], "clearance_m": drive["clearance_m"]},
        f"all four passed, least gap {1e3 * drive['clearance_m']:.0f} mm, "
        f"{drive['plans_used']} of {drive['cycles']} plans used"
        if succeeded
        else "not passed without contact",
        Verdict.of(succeeded),
    )


def model_mismatch(results: Results) -> Finding:
    """Judge the drives through random scenes with a robot that differs from its model."""
    group = results["scenes"]["groups"]["model off by up to 20 %"]
    contacts = group["own_collisions"] + group["other_collisions"]
    return Finding(
        {"drives": group["drives"], "reached": group["reached"], "contacts": contacts},
        f"{group['reached']} of {group['drives']} goals reached, {contacts} contacts",
        Verdict.of(group["own_collisions"] == 0 and group["reached"] >= group["solvable"]),
    )


def wheel_friction(results: Results) -> Finding:
    """Return the identified viscous friction a and Coulomb friction b of the wheels, (24)."""
    wheels = results["identify_friction"]["wheels"]
    a, b = ([wheel[name]["value"] for wheel in wheels] for name in ("viscous", "coulomb"))
    return Finding(
        {"viscous": a, "coulomb": b},
        f"a {min(a):.3f} to {max(a):.3f} N m s, b {min(b):.2f} to {max(b):.2f} N m",
    )


def workshop_drive(results: Results) -> Finding:
    """Return the duration and the smallest gap of the drive through the workshop."""
    drive = find_drive(results["workshop"])
    return Finding(
        {"time_s": drive["time_s"], "clearance_m": drive["clearance_m"]},
        f"out of a dead end and through three doors in {drive['time_s']:.0f} s, least gap "
        f"{1e3 * drive['clearance_m']:.0f} mm"
        if _succeeded(drive)
        else "goal not reached without contact",
    )
