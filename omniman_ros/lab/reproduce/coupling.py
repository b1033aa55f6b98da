"""`omniman reproduce coupling`: the coupling error along the path of CCTA 2017, Fig. 7.

The path is driven with random wheels: without coupling control, with this package's controller at
the robot's own gain, and with the paper's controller, once with (18) as printed and once with J_a
corrected. With `--world` it is driven in the physics world: the lag of the rollers is measured
first, by a rotation in place, and coupling control that knows this lag takes the place of the
paper's.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from statistics import fmean
from typing import Any

import numpy as np

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.lab.reproduce.pipeline import Cell, Experiment, columns
from omniman_ros.lab.studies.calibration import measure_roller_lag
from omniman_ros.lab.studies.coupling import (
    GROUPS,
    LAG_CONTROLLER,
    MISMATCH_SPREAD,
    OWN_CONTROLLER,
    PAPER_CONTROLLER,
    CouplingCase,
    CouplingRun,
    Setup,
    draw_mismatch,
    drive,
)
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.lab.sweep import Sweep
from omniman_ros.lab.verdicts import verdict
from omniman_ros.motion.figure7 import Figure7
from omniman_ros.robots import robot_parameters

PAPER_GAIN = 2.0  #: k_epsilon in Fig. 7 of CCTA 2017 [1/s]
AIM = 0.1  #: largest ratio of the coupling error to that without control, on the plant [-]
WORLD_GAIN = 5.0  #: gain in the physics world, beside the robot's own [1/s]
ERROR_AIM, ENERGY_AIM = 0.25, 1.01  #: largest ratios to those without control in the world [-]
#: The error that each form of coupling control takes out: epsilon by CCTA 2017 (24), and, of the
#: form that knows the lag of the rollers, epsilon less what the lag explains.
MEASURES = {OWN_CONTROLLER: "epsilon_ratio", LAG_CONTROLLER: "error_ratio"}
RATIOS = {"epsilon": "epsilon_max", "error": "error_max", "energy": "energy"}


@dataclass(frozen=True)
class Extent:
    """Extent of the experiment: path, groups of drives on the plant and in the world, wheels."""

    figure: Figure7
    on_plant: Sequence[str]
    in_world: Sequence[str]
    samples: int
    rotation: float  #: duration of the rotation that measures the lag [s]


QUICK = Extent(Figure7(length=1.0), ("P",), ("PI",), samples=1, rotation=2.0)
STANDARD = Extent(Figure7(), tuple(GROUPS), ("P", "PI", "torque"), samples=10, rotation=6.0)
FULL = Extent(Figure7(), tuple(GROUPS), ("P", "PI", "torque"), samples=20, rotation=6.0)


def printed_gain(robot: Mapping[str, Any]) -> float | None:
    """Return the gain k_epsilon with which (18) as printed acts like the paper's gain [1/s].

    The printed last column of J_a is (1/r)(1, 1, -1, -1), and T times this column is 4 / r instead
    of 1: with the corrected J_a, the paper's gain times 4 / r is the same controller.

    Returns:
        The gain; None if the wheels are not those of (15) to (18), four of equal radius with
        T = (1, 1, -1, -1).
    """
    wheels = build(Platform, robot).wheels
    constraints = PlatformKinematics(wheels).T
    equal = len(set(wheels.radius)) == 1
    if constraints.shape != (1, 4) or not equal or not np.allclose(abs(constraints), 1.0):
        return None
    return PAPER_GAIN * 4.0 / wheels.radius[0]


def cases(
    extent: Extent, robot: Mapping[str, Any], own_gain: float, seed: int, *, in_world: bool = False
) -> list[CouplingCase]:
    """Return the cases of all drives; each set of wheels drives with each controller."""
    controllers: list[tuple[str, float]] = [(OWN_CONTROLLER, 0.0)]
    if in_world:
        gains = sorted({WORLD_GAIN, own_gain})
        controllers += [(form, gain) for form in MEASURES for gain in gains]
    else:
        paper = [gain for gain in (PAPER_GAIN, printed_gain(robot)) if gain is not None]
        controllers += [(OWN_CONTROLLER, own_gain), *((PAPER_CONTROLLER, gain) for gain in paper)]
    wheels = build(Platform, robot).wheel_count
    return [
        CouplingCase(group, sample, gain, draw_mismatch(group, seed, sample, wheels), controller)
        for group in (extent.in_world if in_world else extent.on_plant)
        for sample in range(extent.samples)
        for controller, gain in controllers
    ]


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce coupling`; return 0, whether or not the aims are met."""
    extent = QUICK if args.quick else FULL if args.full else STANDARD
    robot = robot_parameters(args.robot)
    own_gain = build(PlatformParameters, robot).coupling.k_epsilon
    setup = Setup(robot, extent.figure)
    selected = cases(extent, robot, own_gain, args.seed, in_world=bool(args.world))
    experiment = Experiment(
        args,
        f"Coupling control along the path of CCTA 2017, Fig. 7: {len(selected)} drives of "
        f"{extent.figure.duration:.0f} s each",
    )
    if args.world:
        world = WorldChoice.of(robot, args.world)
        setup = replace(
            setup, world=world, roller_lag=measure_roller_lag(robot, world, extent.rotation)
        )
    driven = Sweep.here().map(partial(drive, setup), selected)
    runs = experiment.collect(driven, len(selected))
    rows = summary(runs)
    result: dict[str, Any] = {
        "full": args.full,
        "chosen_gain": own_gain,
        "samples": extent.samples,
        "spread": MISMATCH_SPREAD,
        "table": rows,
    }
    if args.world:
        result["roller_lag_s"] = setup.roller_lag
        result["aims"] = [
            world_aim(rows, mode, form) for mode in extent.in_world for form in MEASURES
        ]
        experiment.publish(result, report_world)
        return 0
    reached = remaining_ratio(rows, own_gain)
    result["paper_gain"], result["printed_gain"] = PAPER_GAIN, printed_gain(robot)
    result["aim"] = {"ratio": AIM, "reached": reached, "met": reached <= AIM}
    body = build(Platform, robot)
    result["picture"] = experiment.picture(
        lambda f, path: f.draw_coupling(body, extent.figure, runs, result, path)
    )
    experiment.publish(result, report)
    return 0


def summary(runs: Sequence[CouplingRun]) -> list[dict[str, Any]]:
    """Return mean and worst value of each figure over the wheels, by group, controller and gain.

    `epsilon_ratio`, `error_ratio` and `energy_ratio` relate the `epsilon_max`, `error_max` and
    `energy` of a set of wheels to those of the same wheels without coupling control.
    """
    members: dict[str, dict[tuple[str, float], list[CouplingRun]]] = {}
    for each in runs:
        key = (each.case.controller, each.case.gain)
        members.setdefault(each.case.group, {}).setdefault(key, []).append(each)

    def spread(values: Sequence[float]) -> dict[str, float]:
        return {"mean": fmean(values), "worst": max(values, key=abs)}

    rows = []
    for group, by_gain in members.items():
        off = by_gain[OWN_CONTROLLER, 0.0]
        for (controller, gain), same in sorted(by_gain.items()):
            row: dict[str, Any] = {"group": group, "controller": controller, "k": gain}
            row["about"] = GROUPS[group].about
            for name in asdict(same[0].outcome):
                row[name] = spread([getattr(each.outcome, name) for each in same])
            for name, figure in RATIOS.items():
                pairs = zip(same, off, strict=True)
                row[f"{name}_ratio"] = spread(
                    [getattr(n.outcome, figure) / getattr(o.outcome, figure) for n, o in pairs]
                )
            rows.append(row)
    return rows


def remaining_ratio(rows: Sequence[dict[str, Any]], gain: float) -> float:
    """Return the mean ratio of max |epsilon| at a gain [1/s] to that without control, P loops."""
    key = ("P", OWN_CONTROLLER, gain)
    row = next(row for row in rows if (row["group"], row["controller"], row["k"]) == key)
    return float(row["epsilon_ratio"]["mean"])


def world_aim(rows: Sequence[Mapping[str, Any]], mode: str, form: str) -> dict[str, Any]:
    """Return how near a form of coupling control comes to its aims in one mode.

    Of the gains that meet the aim for the energy, the one that leaves the smallest part of the
    error is taken; if none does, the one with the least energy.
    """
    measure = MEASURES[form]
    driven = [r for r in rows if r["group"] == mode and r["controller"] == form and r["k"] > 0.0]
    cheap = [row for row in driven if row["energy_ratio"]["mean"] <= ENERGY_AIM]
    decisive = measure if cheap else "energy_ratio"
    best = min(cheap or driven, key=lambda row: float(row[decisive]["mean"]))
    error, energy = best[measure]["mean"], best["energy_ratio"]["mean"]
    return {
        "group": mode,
        "controller": form,
        "k": best["k"],
        "error_ratio": error,
        "energy_ratio": energy,
        "error_met": error <= ERROR_AIM,
        "energy_met": energy <= ENERGY_AIM,
    }


def _about(row: Mapping[str, Any], printed: float | None) -> str:
    """Return controller and gain of a row."""
    if row["k"] == 0.0:
        return "off"
    if row["controller"] == PAPER_CONTROLLER:
        return f"paper, {PAPER_GAIN:g} " + ("as printed" if row["k"] == printed else "corrected")
    return f"{row['k']:g}, with lag" if row["controller"] == LAG_CONTROLLER else f"{row['k']:g}"


def _tables(result: Mapping[str, Any]) -> list[str]:
    """Return a table for each group; values are means over the sets of wheels."""
    lines = []
    for about in dict.fromkeys(row["about"] for row in result["table"]):
        table = columns(
            (row for row in result["table"] if row["about"] == about),
            ("k [1/s]", lambda row: _about(row, result.get("printed_gain"))),
            ("max |eps|", "{epsilon_max[mean]:.3f} rad"),
            ("less lag", "{error_max[mean]:.3f} rad"),
            ("ratio to off", "{epsilon_ratio[mean]:.3f}"),
            ("less lag", "{error_ratio[mean]:.2f}"),
            ("worst", "{epsilon_ratio[worst]:.3f}, {error_ratio[worst]:.2f}"),
            ("slip loss", "{slip[mean]:.2f} J"),
            ("energy", "{energy[mean]:.0f} J"),
            ("ratio to off", "{energy_ratio[mean]:.3f}"),
            ("copper", "{copper[mean]:.0f} J"),
            ("tracking", _thousandths("tracking_max", " mm")),
            ("odom error: end", _thousandths("odometry_end", "")),
            ("max", _thousandths("odometry_max", " mm")),
            ("heading", _thousandths("heading_end", " mrad")),
        )
        lines += ["", f"{about}, mean of {result['samples']} sets of wheels:", *table]
    return lines


def _thousandths(key: str, unit: str) -> Cell:
    return lambda row: f"{1e3 * row[key]['mean']:.1f}{unit}"


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on drives on the plant."""
    aim = result["aim"]
    return [
        *_tables(result),
        "(paper: its controller, which is never reset and has no bound, with (18) as printed or "
        "with J_a corrected)",
        "",
        f"max |eps| at k = {result['chosen_gain']:g} in relation to that without control: "
        f"{aim['reached']:.3f}, aim at most {aim['ratio']:g}: {verdict(aim['met'])}",
    ]


def report_world(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on drives in the physics world."""
    lag = 1e3 * result["roller_lag_s"]
    lines = [*_tables(result), "", f"Lag of the rollers, by a rotation in place: {lag:.1f} ms"]
    for aim in result["aims"]:
        error = "epsilon less lag" if aim["controller"] == LAG_CONTROLLER else "epsilon"
        lines.append(
            f"{aim['group']}, k = {_about(aim, None)}: {aim['error_ratio']:.2f} of {error} (aim "
            f"{ERROR_AIM:g}), {aim['energy_ratio']:.3f} of the energy (aim {ENERGY_AIM:g}): "
            f"{verdict(aim['error_met'] and aim['energy_met'])}"
        )
    return lines
