"""`omniman bench faults`: plays the table of faults against the whole running robot."""

import argparse
import math
import os
import statistics
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from omniman_ros.console import results
from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import RED, paint, say
from omniman_ros.lab.bench.harness import Rows, tables
from omniman_ros.lab.faults.judge import UNKNOWN, StopMeasurement
from omniman_ros.lab.faults.player import Player
from omniman_ros.lab.faults.robot_processes import NICENESS
from omniman_ros.lab.faults.rows import Row
from omniman_ros.lab.faults.running_robot import RunningRobot
from omniman_ros.lab.faults.table import ROWS
from omniman_ros.lab.faults.trial import Trial, play
from omniman_ros.lab.priority import own_niceness
from omniman_ros.lab.verdicts import verdict
from omniman_ros.processes.node_output import NodeOutputLog
from omniman_ros.processes.process_group import redirect_signals
from omniman_ros.processes.robot_setup import RobotSetup
from omniman_ros.processes.ros_domain import isolate_ros_domain

#: Nodes that are not started: no row is about them, and none needs them
UNNEEDED = ("joint_states_merger", "viewer", "mpc_planner")
#: Time-outs near those of real installations, which `omniman up` lengthens further.
#:
#: The feedback of a wheel may be missing for 60 ms instead of 15 ms, and a setpoint of the arm for
#: 80 ms instead of 40 ms, as drives and arm are processes beside the nodes.
SHORT_TIMEOUTS = (
    "can.missed_periods:=12",
    "can.drive_heartbeat:=0.03",
    "can.heartbeat_timeout:=0.1",
    "ur.read_timeout:=0.08",
    "ur.feedback_timeout:=0.1",
)
TRIALS = 3  #: number of times in a row that each row is played
AIM = 0.12  #: aim: largest p99 of the time from the evidence until the robot brakes [s]


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench faults`.

    Returns:
        The exit code: 0 if all rows passed in each trial that was judged, else 1; a row without
        such a trial has not passed.
    """
    rows = chosen_rows(args.row)
    if args.list:
        say("\n".join(f"{row.name:32} {row.outcome.value}" for row in rows))
        return 0
    trials = args.trials if args.trials is not None else 1 if args.quick else TRIALS
    if trials < 1:
        raise CommandError(f"--trials {trials}: must be at least 1", 2)
    os.environ.pop("ROS_DOMAIN_ID", None)  # the commands must not reach another robot
    isolate_ros_domain(os.environ)
    result = {"robot": args.robot, "trials": trials, "sim_time": args.sim_time}
    result["rows"] = measure(args.robot, rows, trials, args.sim_time)
    result["load"] = os.getloadavg()[0]
    result |= summary(result["rows"])
    if args.sim_time:  # reactions are uncertain by the lookaheads of the nodes
        result["aims"]["reaction"] = None
    say("\n".join(report(result)))
    results.publish("bench_faults", result, args.results)
    return 0 if result["aims"]["rows"] else 1


def chosen_rows(names: Sequence[str]) -> list[Row]:
    """Return the rows with these names, in the order of the table; all without names."""
    known = {row.name: row for row in ROWS}
    for name in names:
        if name not in known:
            raise CommandError(f"--row '{name}': there is no such row; see --list", 2)
    return [row for row in ROWS if not names or row.name in names]


def measure(
    robot_name: str, rows: Sequence[Row], trials: int, sim_time: bool
) -> list[dict[str, Any]]:
    """Play rows against a robot of their own.

    Returns:
        Name, fault and trials of each row.
    """
    log = NodeOutputLog()
    measured = []
    with Session("omniman_bench", sim_time=sim_time) as session:
        setup = RobotSetup(
            robot=robot_name,
            sim_time=sim_time,
            drive="can",
            collision_monitor=True,
            params=SHORT_TIMEOUTS,
        )
        robot = RunningRobot(session, setup, UNNEEDED, log)
        with redirect_signals(robot.interrupt), own_niceness(NICENESS), robot.processes:
            player = Player(robot)
            robot.follow_clock()
            for row in rows:
                played = [_play_or_start_anew(player, row) for _ in range(trials)]
                measured.append(row_figures(row, played))
                say(_progress(row, played))
    return measured


def _play_or_start_anew(player: Player[RunningRobot], row: Row) -> Trial:
    """Play a row; if the robot cannot be driven, that is the failure, and it is started anew."""
    try:
        return play(player, row)
    except CommandError as error:
        player.remove(row.injection)
        player.robot.restart()
        return Trial(UNKNOWN, UNKNOWN, [str(error)])


def _progress(row: Row, trials: Sequence[Trial]) -> str:
    judged = [trial for trial in trials if trial.is_judged]
    failures = [text for trial in judged for text in trial.failures]
    text = ", ".join(failures) if failures else "passed" if judged else "not judged"
    text = f"{row.name}: {text}"
    return paint(text, RED, sys.stdout) if failures else text


def row_figures(row: Row, trials: Sequence[Trial]) -> dict[str, Any]:
    """Return the figures of a row's trials; `passed` is None if no trial could be judged.

    A trial in which the machine held drives or arm up is not judged, passing or failing alike.
    """
    judged = [trial for trial in trials if trial.is_judged]
    platforms = [trial.platform for trial in judged] if row.platform else []
    arms = [trial.arm for trial in judged] if row.arm else []
    return {
        "row": row.name,
        "unnoticed_s": row.unnoticed,
        "allowed_s": row.reaction,
        "passed": not any(trial.failures for trial in judged) if judged else None,
        "platform_reaction_s": _latest_reaction(platforms, row),
        "arm_reaction_s": _latest_reaction(arms, row),
        "platform_rest_s": max((stop.rest for stop in platforms), default=None),
        "arm_rest_s": max((stop.rest for stop in arms), default=None),
        "failures": [text for trial in judged for text in trial.failures],
        "false_stops": [text for trial in trials for text in trial.false_stops],
        "not_judged": len(trials) - len(judged),
        "trials": [{**asdict(trial), "is_judged": trial.is_judged} for trial in trials],
    }


def _latest_reaction(stops: Sequence[StopMeasurement], row: Row) -> float | None:
    """Return the latest reaction after the evidence [s]; None if nothing has to react."""
    return max((max(stop.reaction - row.unnoticed, 0.0) for stop in stops), default=None)


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the 99th percentile of all reactions [s], and whether the aims were met."""
    reactions = [
        max(trial[part]["reaction"] - row["unnoticed_s"], 0.0)
        for row in rows
        for trial in row["trials"]
        if trial["is_judged"]
        for part in ("platform", "arm")
        if row[f"{part}_reaction_s"] is not None
    ]
    p99 = math.nan
    if len(reactions) > 1 and all(map(math.isfinite, reactions)):
        p99 = statistics.quantiles(reactions, n=100, method="inclusive")[98]
    elif reactions:
        p99 = max(reactions)
    failed = [row["row"] for row in rows if row["passed"] is False]
    unknown = any(row["passed"] is None for row in rows)
    return {
        "reaction_p99_s": p99,
        "false_stops": sum(len(row["false_stops"]) for row in rows),
        "not_judged": sum(row["not_judged"] for row in rows),
        "failed": failed,
        "aims": {
            "rows": None if unknown and not failed else not failed,
            "reaction": p99 <= AIM if p99 == p99 else None,
        },
    }


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    cells: Rows = [("fault, at speed", "platform brakes", "arm", "allowed", "at rest", "")]
    for row in result["rows"]:
        rests = [row["platform_rest_s"], row["arm_rest_s"]]
        known = [rest for rest in rests if rest is not None]
        cells.append(
            (
                row["row"],
                _milliseconds(row["platform_reaction_s"]),
                _milliseconds(row["arm_reaction_s"]),
                f"{_milliseconds(row['allowed_s'])} after {_milliseconds(row['unnoticed_s'])}"
                if known
                else "",
                _milliseconds(max(known)) if known else "",
                verdict(row["passed"], "passed", "FAILED", "not judged"),
            )
        )
    good = result["aims"]["reaction"]
    return [
        *tables(cells),
        f"99th percentile of the reactions {_milliseconds(result['reaction_p99_s'])}, aim "
        f"{_milliseconds(AIM)}: {verdict(good)}",
        f"{len(result['failed'])} of {len(result['rows'])} rows failed; "
        f"{result['false_stops']} stops without a fault; {result['not_judged']} of "
        f"{sum(len(row['trials']) for row in result['rows'])} trials not judged, as the machine "
        f"held drives or arm up; load {result['load']:.1f} on {os.cpu_count()} cores",
    ]


def _milliseconds(seconds: float | None) -> str:
    if seconds is None:
        return ""
    return f"{1e3 * seconds:.0f} ms" if math.isfinite(seconds) else "never"
