"""Coloured verdicts for the reports of benchmarks and experiments."""

import sys

from omniman_ros.console.terminal import GREEN, RED, paint


def verdict(
    good: bool | None, met: str = "met", missed: str = "MISSED", unknown: str = "not measured"
) -> str:
    """Return the text of a verdict, in green or red if the standard output is a terminal.

    Args:
        good: Whether the aim was met; None if there are not enough measurements to decide.
        met: Text if the aim was met.
        missed: Text if the aim was missed.
        unknown: Text if nothing decides.

    Returns:
        One of the three texts.
    """
    if good is None:
        return unknown
    return paint(met, GREEN, sys.stdout) if good else paint(missed, RED, sys.stdout)
