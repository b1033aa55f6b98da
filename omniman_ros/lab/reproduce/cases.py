"""`omniman reproduce free | corridor | moving | workshop`: drives of the planner through a scene.

The first three are the test cases of MPC 2021, section 4; the workshop is a scene with a map.
"""

import argparse
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.lab.registry import EXPERIMENTS
from omniman_ros.lab.reproduce.pipeline import Cell, Experiment, columns
from omniman_ros.lab.studies.mpc_cases import SCENES
from omniman_ros.lab.studies.planned_drives import PlannedDrive, drive_with_planner
from omniman_ros.lab.verdicts import verdict
from omniman_ros.robots import robot_parameters

#: Parameters of the paper's horizon: n = 10 stages of 0.1 s, and no running cost, so that (31)
#: counts at the end only. Limits and a clipped goal remain.
PAPER_HORIZON: Mapping[str, Any] = {
    "horizon.steps": 10,
    "horizon.step": 0.1,
    "weights.running": 0.0,
}


@dataclass(frozen=True)
class Variant:
    """A setting in which a case is driven."""

    about: str  #: short description, which names the drive in the results
    changes: Mapping[str, Any] = field(default_factory=dict)  #: parameters of the planner
    voltages: bool = False  #: whether motor voltages are put out, as in MPC 2021, (20)


VARIANTS = (
    Variant("defaults"),
    Variant("voltages put out", voltages=True),
    Variant("the paper's horizon", PAPER_HORIZON),
)


def run(args: argparse.Namespace) -> int:
    """Run a case.

    Returns:
        1 if a drive with default parameters missed its goal or had a contact, else 0.
    """
    robot, scene = robot_parameters(args.robot), SCENES[args.name]()
    experiment = Experiment(args, EXPERIMENTS[args.name].about)
    # The paper's horizon is too short for a map.
    selected = VARIANTS[: 1 if args.quick else 2 if args.name == "workshop" else 3]

    def driven(variant: Variant) -> PlannedDrive:
        changes, voltages, timer = variant.changes, variant.voltages, time.process_time
        return drive_with_planner(robot, scene, changes, voltages, args.seed, timer, args.world)

    drives = experiment.collect(map(driven, selected), len(selected))
    rows = [
        {
            "about": variant.about,
            "changes": dict(variant.changes),
            "counts": not variant.changes,  # the paper's horizon is reported but may fail
            "voltages": variant.voltages,
            **planned.figures(),
        }
        for variant, planned in zip(selected, drives, strict=True)
    ]
    passed = all(row["reached"] and not row["collided"] for row in rows if row["counts"])
    body = build(Platform, robot)
    picture = experiment.picture(lambda f, path: f.draw_case(body, scene, drives[0], path))
    noise = scene.noise
    result = {"case": args.name, "passed": passed, "observation_noise_m": noise, "drives": rows}
    experiment.publish(result | {"picture": picture}, report)
    return 0 if passed else 1


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
    drives = result["drives"]
    failed = [row["about"] for row in drives if not row["reached"] or row["collided"]]
    names = f" (goal missed or contact: {', '.join(failed)})" if failed else ""
    return [
        "",
        *columns(
            drives,
            ("", "{about}"),
            ("reached", _outcome),
            ("time", _quantity("time_s", "s", 2)),
            ("energy", _quantity("energy_j", "J", 0)),
            ("least gap", _quantity("clearance_m", "mm", 0)),
            ("plans used", "{plans_used} of {cycles}"),
            ("braked", "{brakings}"),
            ("CPU median", _quantity("cpu_median_ms", "ms", 1)),
            ("p99", _quantity("cpu_p99_ms", "ms", 1)),
            ("tracking error", _quantity("tracking_m", "mm", 0)),
        ),
        "",
        "Goal reached without contact, with the defaults: "
        f"{verdict(result['passed'], 'passed', 'FAILED')}{names}",
    ]


def _outcome(row: Mapping[str, Any]) -> str:
    return "CONTACT" if row["collided"] else "yes" if row["reached"] else row["state"]


def _quantity(key: str, unit: str, digits: int) -> Cell:
    """Return the cells of a quantity that may be unknown."""
    scale = 1e3 if unit == "mm" else 1.0
    return lambda row: f"{scale * row[key]:.{digits}f} {unit}" if math.isfinite(row[key]) else "-"
