"""Verdicts in the tables of benchmarks and experiments, as coloured words."""

import sys

from omniman_ros.console.terminal import GREEN, RED, paint


def verdict(good: bool | None, met: str = "met", missed: str = "MISSED") -> str:
    """Return the word for a judgement, green or red on a terminal.

    Args:
        good: Whether the aim was met; None if too little was measured to decide.
        met: Word if the aim was met.
        missed: Word if the aim was missed.
    """
    if good is None:
        return "not measured"
    return paint(met, GREEN, sys.stdout) if good else paint(missed, RED, sys.stdout)
