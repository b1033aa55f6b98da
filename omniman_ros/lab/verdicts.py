"""Coloured verdicts for the reports of benchmarks and experiments."""

import sys

from omniman_ros.console.terminal import GREEN, RED, paint


def verdict(good: bool | None, met: str = "met", missed: str = "MISSED") -> str:
    """Return the text of a verdict, in green or red if the standard output is a terminal.

    Args:
        good: Whether the aim was met; None if there are not enough measurements to decide.
        met: Text if the aim was met.
        missed: Text if the aim was missed.

    Returns:
        One of the two texts, or "not measured".
    """
    if good is None:
        return "not measured"
    return paint(met, GREEN, sys.stdout) if good else paint(missed, RED, sys.stdout)
