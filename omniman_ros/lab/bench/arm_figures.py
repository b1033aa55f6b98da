"""Evaluation of `omniman bench arm`: statistics of the blocks, aims and table."""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.lab.bench.harness import Rows, tables
from omniman_ros.lab.measurement import percentiles_ms
from omniman_ros.lab.verdicts import verdict

AIM_RATIO = 1.5
"""Aim: largest median of all pairs' ratios of the streamer's p99 send interval to the loop's."""
LATE = 0.012
"""Interval between two sends above which the second one counts as late [s]."""
VERY_LATE = 0.020
"""Interval between two sends above which the second one counts as very late [s]."""
MS = 1e3
"""Milliseconds per second [ms/s]."""


@dataclass(frozen=True)
class Block:
    """The measurements of one block.

    Attributes:
        intervals: Intervals between consecutive sends, of the bare loop or of the streamer [s].
        ages: Ages of the newest setpoint that the controller's program has read, by its feedback
            [s]; empty for the bare loop.
    """

    intervals: Sequence[float]
    ages: Sequence[float] = ()


@dataclass(frozen=True)
class Pair:
    """Two consecutive blocks: one without and one with the bare loop.

    Attributes:
        streamer: Measurements of the streamer in the block without the bare loop.
        bare: Measurements of the bare loop in its block.
        beside: Measurements of the streamer in the block of the bare loop.
    """

    streamer: Block
    bare: Block
    beside: Block

    @property
    def ratio(self) -> float:
        """Ratio of the streamer's p99 interval to the bare loop's, each in its own block."""
        return p99(self.streamer.intervals) / p99(self.bare.intervals)

    @property
    def ratio_beside(self) -> float:
        """Ratio of the streamer's p99 interval to the bare loop's, both in the latter's block."""
        return p99(self.beside.intervals) / p99(self.bare.intervals)


def p99(values: Sequence[float]) -> float:
    """Return the 99th percentile of at least one value, interpolated."""
    return float(np.percentile(np.asarray(values, dtype=float), 99))


def spread(values: Sequence[float], prefix: str = "") -> dict[str, float | int]:
    """Return statistics of times: their number, median, 99th percentile and maximum.

    Args:
        values: Times [s]; without any, only their number is returned.
        prefix: Beginning of each key.
    """
    if not len(values):
        return {f"{prefix}count": 0}
    p50, high, top = percentiles_ms(values)
    return {
        f"{prefix}count": len(values),
        f"{prefix}p50_ms": p50,
        f"{prefix}p99_ms": high,
        f"{prefix}max_ms": top,
    }


def summary(blocks: Sequence[Block]) -> dict[str, float | int]:
    """Return statistics of the intervals and ages of all blocks together."""
    intervals = [value for block in blocks for value in block.intervals]
    ages = [value for block in blocks for value in block.ages]
    return {
        **spread(intervals),
        "above_12_ms": sum(value > LATE for value in intervals),
        "above_20_ms": sum(value > VERY_LATE for value in intervals),
        **(spread(ages, "age_") if ages else {}),
    }


def figures(pairs: Sequence[Pair]) -> dict[str, Any]:
    """Return the figures of all pairs of blocks."""
    ratios = [pair.ratio for pair in pairs]
    return {
        "streamer": summary([pair.streamer for pair in pairs]),
        "bare": summary([pair.bare for pair in pairs]),
        "beside_bare": summary([pair.beside for pair in pairs]),
        "pair_p99_ms": [
            [MS * p99(pair.streamer.intervals), MS * p99(pair.bare.intervals)] for pair in pairs
        ],
        "pair_ratios": ratios,
        "ratio": statistics.median(ratios),
        "ratio_beside": statistics.median(pair.ratio_beside for pair in pairs),
    }


def ended_programs(values: Mapping[str, str]) -> int:
    """Return the number of programs that have ended, from the diagnostics of `simulated_ur`.

    The streamer's program on the controller ends by itself only if no setpoint arrives within the
    read time-out, or if the connection is lost.

    Args:
        values: Values of the diagnostics by key.
    """
    return int(values["programs"]) - (values["program_state"] == "PLAYING")


def controller_figures(
    before: Mapping[str, str], after: Mapping[str, str]
) -> dict[str, float | int]:
    """Return the events on the simulated UR controller between two of its diagnostics.

    Args:
        before: Values of the earlier diagnostics by key.
        after: Values of the later diagnostics by key.
    """
    counts = ("servo_calls", "servo_gaps", "protective_stops", "late_cycles")
    return {
        "read_timeouts": ended_programs(after) - ended_programs(before),
        **{name: int(after[name]) - int(before[name]) for name in counts},
        "lost_time_s": float(after["lost_time"]) - float(before["lost_time"]),
    }


def aims(result: Mapping[str, Any]) -> dict[str, bool]:
    """Return whether each aim was met."""
    return {
        "p99_ratio": result["ratio"] <= AIM_RATIO,
        "read_timeouts": result["controller"]["read_timeouts"] == 0,
    }


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    met = {key: verdict(good) for key, good in result["aims"].items()}
    ours, bare, share = result["streamer"], result["bare"], result["cpu_share"]
    sides = (ours, bare)
    rows: Rows = [("", "arm_streamer", "bare loop", "aim", "")]
    for label, key in (("p50", "p50_ms"), ("p99", "p99_ms"), ("max", "max_ms")):
        rows.append(
            (f"send interval, {label}", *(f"{side[key]:.2f} ms" for side in sides), "", "")
        )
    for bound in (12, 20):
        shown = (f"{side[f'above_{bound}_ms']} of {side['count']}" for side in sides)
        rows.append((f"  above {bound} ms", *shown, "", ""))
    ratios = result["pair_ratios"]
    rows.append(
        (
            f"ratio of the p99 intervals, median of {len(ratios)} pairs",
            f"{result['ratio']:.3f}",
            f"({min(ratios):.2f} to {max(ratios):.2f})",
            f"<= {AIM_RATIO:g}",
            met["p99_ratio"],
        )
    )
    rows.append(("  both measured in the same block", f"{result['ratio_beside']:.3f}", "", "", ""))
    for label, key in (("p50", "age_p50_ms"), ("p99", "age_p99_ms"), ("max", "age_max_ms")):
        rows.append((f"setpoint age at the feedback, {label}", f"{ours[key]:.2f} ms", "", "", ""))
    rows.append(
        (
            "share of a core, the loop's process",
            f"{100 * share['streaming']:.1f} %",
            f"{100 * share['bare']:.1f} %",
            "",
            "",
        )
    )
    rows.append(("share of a core, the node", f"{100 * share['node']:.1f} %", "", "", ""))
    scheduling = result["scheduling"]
    rows.append(("scheduling", scheduling["streamer"], scheduling["bare"], "", ""))
    timeouts = result["controller"]["read_timeouts"]
    rows.append(
        ("read time-outs on the UR controller", f"{timeouts}", "", "0", met["read_timeouts"])
    )
    return tables(rows)
