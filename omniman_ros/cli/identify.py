"""`omniman identify SUBJECT`: find out from drives what a robot really is like."""

import argparse
import importlib

SUBJECTS = {"odometry": "identify_odometry", "friction": "identify_friction"}
"""Subject: module in omniman_ros.cli with `run(args) -> int`."""


def run(args: argparse.Namespace) -> int:
    """Run `omniman identify`; returns the exit code."""
    module = importlib.import_module(f"omniman_ros.cli.{SUBJECTS[args.subject]}")
    return int(module.run(args))
