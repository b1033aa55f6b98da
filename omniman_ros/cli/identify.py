"""`omniman identify SUBJECT`: measure properties of a robot by driving it."""

import argparse
import importlib

SUBJECTS = {
    "odometry": "omniman_ros.identification.odometry.command",
    "friction": "omniman_ros.identification.friction.command",
    "floor": "omniman_ros.identification.floor.command",
}  #: Module of each subject, with the function `run(args) -> int`


def run(args: argparse.Namespace) -> int:
    """Run `omniman identify`; the exit code is that of the subject's own command."""
    module = importlib.import_module(SUBJECTS[args.subject])
    return int(module.run(args))
