"""Arguments of the commands of the laboratory: `omniman bench` and `omniman reproduce`."""

import argparse

from omniman_ros.cli.arguments.common import ROBOT_HELP, add_parameters, add_results, add_robot

BENCHMARKS = {
    "control": "time of a control tick, CPU of the nodes, latency (default)",
    "nodes": "CPU time of a tick and of the start of platform_controller next to a bare node",
    "participants": "stops and gaps of a robot while participants come and go",
    "path": "time of planning, distance from the least time, CPU of the stream",
    "mpc": "CPU and cost of the planner's solver next to IPOPT and fatrop",
    "can": "round trips over a CAN bus of UDP next to a bare echo, CPU, bus load",
    "arm": "setpoints at 125 Hz in the whole running robot next to a bare loop",
    "collision": "CPU time of distances between the robot's parts, and from what stands around it",
    "tracker": "people in the physics world as the obstacle tracker sees them: velocity, identity",
    "clutter": "the planner in worlds of BARN's kind, map known and by scanner: score, CPU",
    "crowd": "the planner among 20 moving discs: goals per minute, contacts, CPU",
    "whole_body": "time of planning tool paths, CPU of their stream, inverse kinematics",
    "whole_body_obstacles": "the body dodges, the tool stays on its path; next to a fixed posture",
    "stability": "tracking and lifted wheels with the arm stretched, posture known or not",
    "faults": "reactions of the whole running robot to each row of the table of faults",
    "soak": "memory, contacts and false stops of a robot that is driven and disturbed for hours",
    "world": "speed of the physics world over real time, CPU of its node and of a laser scan",
}
"""Measured quantities of each benchmark, for the help text."""

EXPERIMENTS = {
    "coupling": "CCTA 2017 Fig. 7, coupling control on and off (default)",
    "odometry": "odometry after the path of CCTA 2017 Fig. 7, by the wheels and with imu",
    "tool_path": "platform and arm in step, with and without the arm's correction",
    "free": "the free case of MPC 2021",
    "free_paper": "the same with the paper's own problem: weights, friction, mass, voltages out",
    "corridor": "the corridor case of MPC 2021",
    "moving": "the case of MPC 2021 with moving obstacles",
    "handover": "two robots meet in motion, drive side by side, and part again",
    "workshop": "rooms and doors, with a map",
    "scenes": "random scenes",
    "all": "all experiments in turn, and a page that compares measured with published figures",
}
"""Description of each experiment, for the help text."""

WORLD_WHEELS = ("rollers", "ideal")
"""Kinds of wheels of the physics world, the default first; their module is too heavy for help."""


def add_bench(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman bench`."""
    parser.add_argument(
        "name",
        nargs="?",
        default="control",
        choices=list(BENCHMARKS),
        help=_describe(BENCHMARKS),
    )
    effort = parser.add_mutually_exclusive_group()
    effort.add_argument(
        "--quick", action="store_true", help="take a few samples only, to see that it runs"
    )
    effort.add_argument("--full", action="store_true", help="mpc: more steps, scenes and horizons")
    add_robot(parser)
    add_results(parser)
    faults = parser.add_argument_group("faults only")
    faults.add_argument(
        "--row",
        action="append",
        default=[],
        metavar="NAME",
        help="play this row of the table; may be repeated; default: all rows",
    )
    faults.add_argument("--trials", type=int, metavar="N", help="plays of each row; default: 3")
    faults.add_argument("--list", action="store_true", help="list the rows, and play none")
    both = parser.add_argument_group("faults and soak only")
    both.add_argument(
        "--sim-time",
        action="store_true",
        help="run the robot in simulated time: a busy machine makes it slow, not late",
    )
    soak = parser.add_argument_group("soak only")
    duration = soak.add_mutually_exclusive_group()
    duration.add_argument(
        "--minutes", type=float, metavar="N", help="duration; default: 60, with --quick 3"
    )
    duration.add_argument(
        "--hours", type=lambda text: 60.0 * float(text), dest="minutes", metavar="N"
    )
    drives = parser.add_argument_group("clutter and crowd only")
    drives.add_argument(
        "--worlds", type=int, metavar="N", help="number of worlds; default: 300; crowds: 6"
    )
    drives.add_argument(
        "--jobs", type=int, metavar="N", help="number of processes; default: that of the CPUs"
    )
    drives.add_argument(
        "--sense", choices=("known", "scanner"), help="clutter: this only; default: both"
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        help="soak, clutter, crowd: seed, or the first one; default: %(default)s",
    )
    arm = parser.add_argument_group("arm only")
    arm.add_argument("--pairs", type=int, metavar="N", help="pairs of blocks; default: 5")
    arm.add_argument("--seconds", type=float, metavar="S", help="length of each block; default: 8")
    arm.add_argument(
        "--priority",
        type=int,
        default=50,
        metavar="N",
        help="priority of both loops, SCHED_FIFO where it is permitted; 0: none (a busy machine "
        "may then need -p ur.read_timeout:=0.2); default: %(default)s",
    )
    add_parameters(arm)


def add_reproduce(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman reproduce`."""
    parser.add_argument(
        "name",
        nargs="?",
        default="coupling",
        choices=list(EXPERIMENTS),
        help=_describe(EXPERIMENTS),
    )
    effort = parser.add_mutually_exclusive_group()
    effort.add_argument(
        "--quick", action="store_true", help="drive a few times only, to see that it runs"
    )
    effort.add_argument("--full", action="store_true", help="drive more often")
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        help="seed of random wheels and of noisy observations; default: %(default)s",
    )
    parser.add_argument(
        "--robot",
        help=f"{ROBOT_HELP}; default: omniman for coupling, odometry, tool_path and handover, "
        "else ig42",
    )
    parser.add_argument(
        "--reuse",
        action="store_true",
        help="with all: do not repeat an experiment whose JSON file is in the folder",
    )
    parser.add_argument(
        "--world",
        nargs="?",
        choices=WORLD_WHEELS,
        const=WORLD_WHEELS[0],
        help="drive in the physics world instead of on the plant, on wheels with rollers or on "
        "ideal ones; with all: there as well; default wheels: %(const)s",
    )
    add_results(parser)
    scenes = parser.add_argument_group("scenes only, also as part of all")
    scenes.add_argument("--count", type=int, help="number of scenes, from seed 0 on; default: 240")
    scenes.add_argument("--seeds", metavar="A:B", help="seeds A to B - 1, or a single seed")
    scenes.add_argument(
        "--jobs", type=int, help="number of processes; default: the number of CPUs"
    )
    scenes.add_argument(
        "--arm",
        action="store_true",
        default=None,
        help="with the arm in random postures among obstacles of all heights, judged in three "
        "dimensions; default robot: omniman",
    )
    scenes.add_argument(
        "--solve-time",
        type=float,
        metavar="SECONDS",
        help="time assumed for each answer of the solver, in place of the measured time, so that "
        "a run repeats exactly",
    )


def _describe(choices: dict[str, str]) -> str:
    """Return the choices of an argument, each with its description, as one help text."""
    return ". ".join(f"{name}: {text}" for name, text in choices.items())
