"""Coloured verdicts for the reports of benchmarks and experiments."""

import sys

from omniman_ros.console.terminal import GREEN, RED, paint


def verdict(
    good: bool | None, met: str = "met", missed: str = "MISSED", unknown: str = "not measured"
) -> str:
    """Return the text of a verdict, in green or red if the standard output is a terminal."""
    if good is None:
        return unknown
    return paint(met, GREEN, sys.stdout) if good else paint(missed, RED, sys.stdout)
