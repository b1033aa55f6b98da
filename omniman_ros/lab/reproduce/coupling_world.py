"""`omniman reproduce coupling --world`: the path of CCTA 2017, Fig. 7, in the physics world.

The wheels have rollers, or are ideal ones. The lag of the rollers is measured first, by a rotation
in place; then the path is driven with random wheels, without coupling control, with it, and with
it and the lag. Both forms of control have an aim for the error that they take out, and one for the
energy.
"""

import argparse
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import table
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.reproduce.experiments import result_name
from omniman_ros.lab.reproduce.pipeline import collect, publish
from omniman_ros.lab.studies.coupling import (
    LAG_CONTROLLER,
    MISMATCH_SPREAD,
    OWN_CONTROLLER,
    Case,
    Setup,
    draw_mismatch,
)
from omniman_ros.lab.studies.coupling_sweep import summary, sweep
from omniman_ros.lab.studies.roller_lag import measure_roller_lag
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.lab.verdicts import verdict
from omniman_ros.motion.figure7 import Figure7
from omniman_ros.robots import load_robot

MODES = ("P", "PI", "torque")
"""Groups of drives: the ways in which the drives hold a wheel's speed."""
GAINS = (5.0,)
"""Gains of coupling control, with and without lag, beside the robot's own [1/s]."""
MEASURES = {OWN_CONTROLLER: "epsilon_ratio", LAG_CONTROLLER: "error_ratio"}
"""The error that each form of coupling control takes out, as the ratio to that without control:
epsilon by CCTA 2017 (24), and, of the form that knows the lag, epsilon less what the lag
explains."""
ERROR_AIM = 0.25
"""Aim: largest ratio of the largest error to that without coupling control [-]."""
ENERGY_AIM = 1.01
"""Aim: largest ratio of the energy to that without coupling control [-]."""


@dataclass(frozen=True)
class Extent:
    """Extent of the study.

    Attributes:
        figure: The path as a function of time.
        modes: Groups of drives, keys of `GROUPS`.
        gains: Gains of coupling control, with and without lag, beside the robot's own [1/s].
        samples: Number of sets of random wheels.
        rotation: Duration of the rotation that measures the lag [s].
    """

    figure: Figure7
    modes: Sequence[str]
    gains: Sequence[float]
    samples: int
    rotation: float


QUICK = Extent(Figure7(length=1.0), ("PI",), (), samples=1, rotation=2.0)
"""Extent of a quick run: a short path, one set of wheels and one way to hold a wheel's speed."""
STANDARD = Extent(Figure7(), MODES, GAINS, samples=10, rotation=6.0)
"""Extent of a standard run."""
FULL = Extent(Figure7(), MODES, (2.0, *GAINS, 8.0, 30.0), samples=20, rotation=6.0)
"""Extent of a full run."""


def cases(extent: Extent, robot: Mapping[str, Any], own_gain: float, seed: int) -> list[Case]:
    """Return the cases of all drives.

    Args:
        extent: Extent of the study.
        robot: Parameters of the robot, full names to values.
        own_gain: The robot's own gain [1/s].
        seed: Seed of the random wheels.
    """
    wheels = build(Robot, robot).wheel_count
    gains = sorted({own_gain, *extent.gains})
    controllers = [(form, gain) for form in MEASURES for gain in gains]
    controllers.insert(0, (OWN_CONTROLLER, 0.0))
    return [
        Case(mode, sample, gain, draw_mismatch(mode, seed, sample, wheels), controller)
        for mode in extent.modes
        for sample in range(extent.samples)
        for controller, gain in controllers
    ]


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce coupling --world`.

    Args:
        args: Parsed command line.

    Returns:
        0, whether or not the aims are met.
    """
    extent = QUICK if args.quick else FULL if args.full else STANDARD
    robot = load_robot(args.robot)
    own_gain = build(PlatformParameters, robot).coupling.k_epsilon
    world = WorldChoice.of(robot, args.world)
    selected = cases(extent, robot, own_gain, args.seed)
    started = time.monotonic()
    progress = Progress()
    progress.headline(
        f"Coupling control along the path of CCTA 2017, Fig. 7, in the physics world, wheels "
        f"'{args.world}': {len(selected)} drives of {extent.figure.duration:.0f} s each, robot "
        f"'{args.robot}'"
    )
    lag = measure_roller_lag(robot, world, extent.rotation)
    setup = Setup(robot, extent.figure, world, lag)
    generator = sweep(setup, selected, os.cpu_count() or 1)
    rows = summary(collect(progress, "drives", generator, len(selected), "drives"))
    result = {
        "robot": args.robot,
        "world": args.world,
        "quick": args.quick,
        "full": args.full,
        "seed": args.seed,
        "chosen_gain": own_gain,
        "samples": extent.samples,
        "spread": MISMATCH_SPREAD,
        "roller_lag_s": lag,
        "table": rows,
        "aims": [aim(rows, mode, form) for mode in extent.modes for form in MEASURES],
    }
    publish(result_name(args.name, args.world), result, report, started, args.results)
    return 0


def aim(rows: Sequence[Mapping[str, Any]], mode: str, form: str) -> dict[str, Any]:
    """Return how near a form of coupling control comes to its aims in one mode.

    Of the gains that meet the aim for the energy, the one that leaves the smallest part of the
    error is taken; if none does, the one with the least energy.

    Args:
        rows: Rows of the table.
        mode: Group of the drives.
        form: Name of the coupling controller, a key of `MEASURES`.
    """
    measure = MEASURES[form]
    driven = [r for r in rows if r["group"] == mode and r["controller"] == form and r["k"] > 0.0]
    cheap = [row for row in driven if row["energy_ratio"]["mean"] <= ENERGY_AIM]
    best = (
        min(cheap, key=lambda row: float(row[measure]["mean"]))
        if cheap
        else min(driven, key=lambda row: float(row["energy_ratio"]["mean"]))
    )
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


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal; values are means over the sets of wheels."""
    lines = []
    for about in dict.fromkeys(row["about"] for row in result["table"]):
        rows: list[tuple[str, ...]] = [
            (
                "coupling control",
                "max |eps|",
                "less lag",
                "ratios to off",
                "worst",
                "energy",
                "ratio to off",
                "copper",
                "slip loss",
                "tracking",
                "odom error, end",
            )
        ]
        rows += [_cells(row) for row in result["table"] if row["about"] == about]
        lines += ["", f"{about}, mean of {result['samples']} sets of wheels:", *table(rows)]
    lag = 1e3 * result["roller_lag_s"]
    lines += ["", f"Lag of the rollers, measured by a rotation in place: {lag:.1f} ms"]
    for reached in result["aims"]:
        met = verdict(reached["error_met"] and reached["energy_met"])
        with_lag = reached["controller"] == LAG_CONTROLLER
        form = "with lag, " if with_lag else ""
        error = "epsilon less lag" if with_lag else "epsilon"
        lines.append(
            f"{reached['group']}, {form}k = {reached['k']:g}: "
            f"{reached['error_ratio']:.2f} of {error} (aim {ERROR_AIM:g}), "
            f"{reached['energy_ratio']:.3f} of the energy (aim {ENERGY_AIM:g}): {met}"
        )
    return lines


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    mean = {name: value["mean"] for name, value in row.items() if isinstance(value, dict)}
    lag = ", with lag" if row["controller"] == LAG_CONTROLLER else ""
    return (
        f"k = {row['k']:g}{lag}" if row["k"] or lag else "off",
        f"{mean['epsilon_max']:.3f} rad",
        f"{mean['error_max']:.3f} rad",
        f"{mean['epsilon_ratio']:.2f}, {mean['error_ratio']:.2f}",
        f"{row['epsilon_ratio']['worst']:.2f}, {row['error_ratio']['worst']:.2f}",
        f"{mean['energy']:.0f} J",
        f"{mean['energy_ratio']:.3f}",
        f"{mean['copper']:.0f} J",
        f"{mean['slip']:.0f} J",
        f"{1e3 * mean['tracking_max']:.1f} mm",
        f"{1e3 * mean['odometry_end']:.1f} mm, {mean['heading_end']:.3f} rad",
    )
