"""The benchmarks of `omniman bench` and the experiments of `omniman reproduce`.

One table gives the commands, their options, their help and their tables in the documentation.
"""

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

WHEELS = ("rollers", "ideal")  #: of the physics world, whose module is too heavy for help


class Option(NamedTuple):
    """An option of the command line: its name and the arguments of `add_argument`."""

    flag: str
    settings: Mapping[str, Any]


def option(flag: str, **settings: Any) -> Option:
    """Return an option."""
    return Option(flag, settings)


@dataclass(frozen=True)
class Study:
    """A benchmark or an experiment."""

    module: str  #: module below `omniman_ros.lab` with the function `run(args) -> int`
    about: str  #: what is measured or driven, for help and documentation
    options: tuple[Option, ...] = ()  #: options of its own
    efforts: tuple[str, ...] = ("quick",)  #: `--quick`, and `--full` where there is more
    robot: str | None = "omniman"  #: if `--robot` names none; None if it has one of its own
    parameters: bool = False  #: whether it takes `--param`

    def defaults(self, name: str, **given: Any) -> argparse.Namespace:
        """Return the arguments of a run without options, less those that are given."""
        parser = argparse.ArgumentParser()
        for flag, settings in self.options:
            parser.add_argument(flag, **settings)
        base = {"name": name, "quick": False, "full": False, "robot": self.robot, "param": []}
        return argparse.Namespace(**{**base, **vars(parser.parse_args([])), **given})


SIM_TIME = option(
    "--sim-time",
    action="store_true",
    help="run the robot in simulated time: a busy machine makes it slow, not late",
)
SEED = option("--seed", type=int, default=0, metavar="N", help="seed; default: %(default)s")
JOBS = option(
    "--jobs", type=int, metavar="N", help="number of processes; default: that of the CPUs"
)
SWEEP = (
    JOBS,
    option(
        "--dask",
        metavar="ADDRESS",
        help="compute on a Dask cluster, by the address of its scheduler, in place of processes "
        "here",
    ),
)
WORLD = option(
    "--world",
    nargs="?",
    choices=WHEELS,
    const=WHEELS[0],
    help="drive in the physics world instead of on the plant, on wheels with rollers or on ideal "
    "ones; default wheels: %(const)s",
)


def worlds(default: int) -> Option:
    """Return the option of the number of worlds."""
    return option("--worlds", type=int, metavar="N", help=f"number of worlds; default: {default}")


BENCHMARKS = {
    "control": Study("bench.control", "time of a control tick, CPU time, latency beside a relay"),
    "path": Study("bench.path", "time of planning, distance from the least time, CPU time"),
    "mpc": Study(
        "bench.mpc",
        "the planner's solver beside acados and IPOPT on the same problems: CPU time, cost",
        efforts=("quick", "full"),
    ),
    "can": Study(
        "bench.can_bus",
        "round trips over a CAN bus of UDP beside bare python-can, CPU time, bus load",
        robot=None,
    ),
    "arm": Study(
        "bench.arm",
        "setpoints of the arm at 125 Hz in the whole running robot beside a bare loop",
        (
            option(
                "--priority",
                type=int,
                default=50,
                metavar="N",
                help="priority of both loops, SCHED_FIFO where it is permitted; 0: none (a busy "
                "machine may then need -p ur.read_timeout:=0.2); default: %(default)s",
            ),
        ),
        parameters=True,
    ),
    "whole_body": Study(
        "bench.whole_body",
        "planning of tool paths, CPU time of their stream, inverse kinematics beside Newton's",
    ),
    "whole_body_obstacles": Study(
        "bench.whole_body_obstacles",
        "the body avoids obstacles in the physics world, the tool stays on its path, beside a "
        "fixed posture: completed scenes, contacts, error of the tool, CPU time of a cycle",
        (
            option("--scenes", type=int, metavar="N", help="scenes of each kind; default: 25"),
            *SWEEP,
        ),
    ),
    "whole_body_running": Study(
        "bench.whole_body_running",
        "paths of the tool with all nodes as processes in the physics world and nothing around, "
        "beside `path_interpolator`: error of the tool; a planner that is killed or frozen",
    ),
    "tracker": Study(
        "bench.tracker",
        "people in the physics world as `obstacle_tracker` sees them: velocity, identity, false "
        "alarms, CPU time",
    ),
    "clutter": Study(
        "bench.clutter",
        "the planner in worlds of BARN's kind, map known and by scanner: goals, contacts, score, "
        "CPU time",
        (worlds(300), *SWEEP, SEED),
        robot=None,
    ),
    "crowd": Study(
        "bench.crowd",
        "the planner among 20 discs that see nobody or give way, beside ORCA and a dynamic "
        "window and Nav2's MPPI: goals per minute, contacts, CPU time",
        (worlds(12), *SWEEP, SEED),
        robot=None,
    ),
    "world": Study(
        "bench.world",
        "speed of the physics world over real time, CPU time of its node and of a laser scan",
    ),
    "faults": Study(
        "bench.faults",
        "reactions of the whole running robot to each row of the table of faults",
        (
            option(
                "--row",
                action="append",
                default=[],
                metavar="NAME",
                help="play this row of the table; may be repeated; default: all rows",
            ),
            option("--trials", type=int, metavar="N", help="plays of each row; default: 3"),
            option("--list", action="store_true", help="list the rows, and play none"),
            SIM_TIME,
        ),
    ),
    "soak": Study(
        "bench.soak",
        "a robot that is driven and disturbed at random for hours: memory, descriptors, contacts, "
        "stops without a fault",
        (
            option("--minutes", type=float, metavar="N", help="duration; default: 60, --quick: 3"),
            option(
                "--hours",
                type=lambda text: 60.0 * float(text),
                dest="minutes",
                metavar="N",
                help="duration",
            ),
            SEED,
            SIM_TIME,
        ),
    ),
}
EXPERIMENTS = {
    "coupling": Study(
        "reproduce.coupling",
        "CCTA 2017, Fig. 7: no coupling control, the default gain, the paper's controller",
        (SEED, WORLD),
        ("quick", "full"),
    ),
    "odometry": Study(
        "reproduce.odometry",
        "odometry after the path of CCTA 2017, Fig. 7, by the wheels alone and with imu",
        (SEED, WORLD),
        ("quick", "full"),
    ),
    "tool_path": Study(
        "reproduce.tool_path",
        "platform and arm in step, with and without the arm's correction",
        (SEED, WORLD),
    ),
    "dodge": Study(
        "reproduce.dodge",
        "CCTA 2017, V.A: the body dodges posts, a table and persons, the tool stays on its path",
        (SEED,),
    ),
    "free": Study("reproduce.cases", "MPC 2021, 4.1: free movement", (SEED, WORLD), robot="ig42"),
    "corridor": Study(
        "reproduce.cases", "MPC 2021, 4.2: a narrow corridor", (SEED, WORLD), robot="ig42"
    ),
    "moving": Study(
        "reproduce.cases", "MPC 2021, 4.3: moving obstacles", (SEED, WORLD), robot="ig42"
    ),
    "handover": Study(
        "reproduce.handover",
        "MPC 2021, 5: two robots meet in motion, drive side by side, and part again",
        (SEED, WORLD),
    ),
    "workshop": Study(
        "reproduce.cases",
        "rooms with a map: out of a dead end, and through three doors",
        (SEED, WORLD),
        robot="ig42",
    ),
    "scenes": Study(
        "reproduce.scenes",
        "the planner's node through random scenes, judged by a geometry of its own",
        (
            SEED,
            WORLD,
            option("--seeds", metavar="A:B", help="seeds A to B - 1, or one; default: 0:240"),
            option(
                "--sense",
                choices=("markers", "scanner"),
                default="markers",
                help="obstacles by noisy markers, or by two laser scanners in the physics world "
                "(--world ideal, unless it is given); default: %(default)s",
            ),
            *SWEEP,
            option(
                "--solve-time",
                type=float,
                metavar="SECONDS",
                help="time assumed for each answer of the solver, in place of the measured time, "
                "so that a run repeats exactly",
            ),
        ),
        ("quick", "full"),
        robot="ig42",
    ),
    "all": Study(
        "reproduce.all_experiments",
        "all of these in turn, and a table of their outcomes",
        (SEED, WORLD),
        ("quick", "full"),
        robot=None,
    ),
}


def markdown(command: str) -> Iterator[str]:
    """Yield the table of the commands `omniman bench` or `omniman reproduce`."""
    yield from ("| command | what it measures |", "|---|---|")
    for name, study in (BENCHMARKS if command == "bench" else EXPERIMENTS).items():
        flags = [f"`{flag}`" for flag, _ in study.options]
        yield f"| `omniman {command} {name}` | {study.about}. {', '.join(flags)} |"
