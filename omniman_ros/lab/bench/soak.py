"""`omniman bench soak`: drives and disturbs a robot at random for hours, and watches it."""

import argparse
import contextlib
import math
import os
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from omniman_ros.console import results
from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import say
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import OmnimanError
from omniman_ros.demo.figures import obstacle_gaps
from omniman_ros.lab.bench.harness import Rows, tables
from omniman_ros.lab.faults.injections import STREAMING_PROCESS
from omniman_ros.lab.faults.player import Player
from omniman_ros.lab.faults.robot_processes import NICENESS
from omniman_ros.lab.faults.running_robot import RunningRobot
from omniman_ros.lab.faults.trial import LONGEST_HOLD_UP
from omniman_ros.lab.priority import own_niceness
from omniman_ros.lab.soak.activities import Activities
from omniman_ros.lab.soak.usage import Usage, longest_life, usage, usage_figures
from omniman_ros.lab.soak.waiting import LONGEST_WAIT, WaitingWatch
from omniman_ros.lab.verdicts import verdict
from omniman_ros.processes.node_output import NodeOutputLog
from omniman_ros.processes.process_group import redirect_signals
from omniman_ros.processes.robot_setup import RobotSetup
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.robots import robot_parameters

MINUTES, QUICK_MINUTES = 60.0, 3.0  #: duration without options, and with `--quick` [min]
LEFT_OUT = ("viewer",)  # nodes that are not started
SAMPLE_PERIOD = 2.0  #: shortest time between two samples of what the processes use [s]
READY_TIMEOUT = 60.0  #: longest time until a robot is ready, or reset [s]
AFTERMATH = 1.0  #: time after a reset in which a stop still counts as that of the fault before [s]
SPEED_TOLERANCE = 1.05  #: ratio of the true speed to its limit that is permitted: drives overshoot
#: Speed by which a turn at the largest yaw rate adds to that of the platform [m/s]
YAW_ARM_SPEED = 0.6
JUDGED_TIME = 600.0  #: duration from which on the growth of the memory is judged [s]
MEMORY_GROWTH = 20.0  #: aim: largest growth of the memory of a process [MiB per hour]
COUNT_GROWTH = 8  #: aim: largest growth of the number of descriptors or threads of a process


class SoakWatch:
    """Collects what must hold all the while, from ground truth and from the processes."""

    def __init__(
        self,
        robot: RunningRobot,
        activities: Activities,
        half_size: Sequence[float],
        speed_limit: float,
    ) -> None:
        self._robot, self._activities = robot, activities
        self._half_size, self._speed_limit = half_size, speed_limit
        self._sampled = -math.inf
        self.samples: dict[str, list[Usage]] = {}
        self.least_gap, self.fastest = math.inf, 0.0
        self._held_up = False
        self._waiting = WaitingWatch()
        if not robot.session.is_simulated:  # there, time waits for a process that waits
            robot.on_check = self._look_at_waiting
        self.false_stops: list[str] = []
        self.held_up_stops = 0
        self.ended: list[str] = []

    def look(self) -> None:
        """Evaluate the ground truth since the last call, and sample the processes."""
        platform, hold_up = self._robot.truth.platform, self._robot.truth.longest_hold_up
        self._held_up = hold_up > LONGEST_HOLD_UP or self._waiting.longest > LONGEST_WAIT
        self._robot.truth.clear()
        self._waiting.clear()
        if len(platform):
            self.fastest = max(self.fastest, float(platform[:, 1].max()))
            self.least_gap = min(self.least_gap, self._gap(platform))
        self.ended += self._robot.processes.ended
        now = time.monotonic()
        if now - self._sampled >= SAMPLE_PERIOD:
            self._sampled = now
            for name in [*self._robot.processes.names, STREAMING_PROCESS]:
                self._sample(name, now)

    def _look_at_waiting(self) -> None:
        """Sample how long the processes wait for a core."""
        pids, processes = [], self._robot.processes
        for name in [*processes.names, STREAMING_PROCESS]:
            with contextlib.suppress(CommandError, KeyError):
                pids.append(processes.pid(name))
        self._waiting.look(pids, time.monotonic())

    def _sample(self, name: str, now: float) -> None:
        try:
            sample = usage(self._robot.processes.pid(name), now)
        except CommandError:
            return
        if sample is not None:
            self.samples.setdefault(name, []).append(sample)

    def _gap(self, platform: Array) -> float:
        rows = np.column_stack([np.zeros(len(platform)), platform[:, 2:5]])
        return float(obstacle_gaps(self._activities.obstacles, rows, self._half_size).min())

    def note_stops(self) -> None:
        """Note the stops of a robot that was not disturbed, and those of a busy machine apart."""
        stopped = self._robot.stopped
        if self._activities.disturbed or not stopped:
            return
        if self._held_up:
            self.held_up_stops += 1
        else:
            self.false_stops += [f"{name}: {self._robot.reasons[name]}" for name in stopped]

    def figures(self) -> dict[str, Any]:
        """Return all figures for the JSON result."""
        return {
            "least_gap_m": self.least_gap,
            "fastest_m_s": self.fastest,
            "speed_limit_m_s": self._speed_limit,
            "false_stops": self.false_stops,
            "held_up_stops": self.held_up_stops,
            "ended": self.ended,
            "unanswered": self._robot.services.unanswered,
            "processes": {
                name: usage_figures(longest_life(samples))
                for name, samples in self.samples.items()
            },
        }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench soak`.

    Returns:
        The exit code: 0 if all aims were met, else 1.
    """
    minutes = args.minutes or (QUICK_MINUTES if args.quick else MINUTES)
    if not 0.1 <= minutes <= 10000.0:
        raise CommandError(f"--minutes {minutes:g}: must be from 0.1 to 10000", 2)
    os.environ.pop("ROS_DOMAIN_ID", None)  # the commands must not reach another robot
    isolate_ros_domain(os.environ)
    clock = "simulated" if args.sim_time else "real"
    say(f"{minutes:g} minutes of {clock} time with seed {args.seed} ...")
    result = {"robot": args.robot, "minutes": minutes, "seed": args.seed}
    result["sim_time"] = args.sim_time
    result |= soak(args.robot, 60.0 * minutes, args.seed, args.sim_time)
    result["load"] = os.getloadavg()[0]
    result["aims"] = aims(result)
    say("\n".join(report(result)))
    results.publish("bench_soak", result, args.results)
    return 0 if all(good is not False for good in result["aims"].values()) else 1


def soak(robot_name: str, seconds: float, seed: int, sim_time: bool) -> dict[str, Any]:
    """Drive and disturb a robot.

    Returns:
        The figures.
    """
    values = robot_parameters(robot_name)
    half_size = (0.5 * values["body.length"], 0.5 * values["body.width"])
    limit = SPEED_TOLERANCE * (values["limits.linear_velocity"] + YAW_ARM_SPEED)
    log = NodeOutputLog()
    setup = RobotSetup(robot=robot_name, sim_time=sim_time, drive="can", collision_monitor=True)
    with Session("omniman_bench", sim_time=sim_time) as session:
        robot = RunningRobot(session, setup, LEFT_OUT, log)
        with redirect_signals(robot.interrupt), own_niceness(NICENESS), robot.processes:
            activities = Activities(Player(robot), seed)
            with activities.client:
                watch = SoakWatch(robot, activities, half_size, limit)
                robot.follow_clock()
                if not robot.release(READY_TIMEOUT):
                    log.show()
                    raise CommandError(f"the robot does not become ready: {robot.reasons}")
                start = robot.session.now()
                stuck = ""
                with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C ends it, with the report
                    stuck = drive(robot, activities, watch, start + seconds)
                if stuck:
                    log.show()
                driven = (robot.session.now() - start) / 60.0
            counts = activities.counts
            return {**watch.figures(), "driven_min": driven, "activities": counts, "stuck": stuck}


def drive(robot: RunningRobot, activities: Activities, watch: SoakWatch, end: float) -> str:
    """Perform activities until a time [s]; return why that could not go on, or an empty string."""
    while robot.session.now() < end:
        try:
            activities.perform()
        except (CommandError, OmnimanError) as error:
            return f"{error}; the last report was {robot.truth.age:.1f} s old when it was read"
        watch.look()
        watch.note_stops()
        robot.release(READY_TIMEOUT)
        robot.pause(AFTERMATH)  # what a fault has left behind may stop the robot once more
        if not robot.release(READY_TIMEOUT):
            return f"{robot.reasons}"
        activities.disturbed = False
        if watch.ended:
            return ""
    return ""


def aims(result: Mapping[str, Any]) -> dict[str, bool | None]:
    """Return whether each aim was met; None where the run was too short to tell."""
    processes = result["processes"].values()
    judged = [item for item in processes if item["seconds"] >= JUDGED_TIME]
    counts = ("descriptors_growth", "threads_growth")
    return {
        "contact": result["least_gap_m"] > 0.0,
        "speed": result["fastest_m_s"] <= result["speed_limit_m_s"],
        "processes": not result["ended"],
        "reset": not result["stuck"],
        "false_stops": not result["false_stops"],
        "counts": all(item[key] <= COUNT_GROWTH for item in processes for key in counts),
        "memory": all(item["memory_growth_MiB_per_hour"] <= MEMORY_GROWTH for item in judged)
        if judged
        else None,
    }


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    rows: Rows = [("process", "of a core", "memory", "growth", "descriptors", "threads")]
    for name, item in result["processes"].items():
        rows.append(
            (
                name,
                f"{100 * item['cpu_share']:.1f} %",
                f"{item['memory_MiB']:.0f} MiB",
                f"{item['memory_growth_MiB_per_hour']:+.1f} MiB/h",
                f"{item['descriptors']} ({item['descriptors_growth']:+d})",
                f"{item['threads']} ({item['threads_growth']:+d})",
            )
        )
    met = {key: verdict(good) for key, good in result["aims"].items()}
    done = ", ".join(f"{count} {name}" for name, count in result["activities"].items())
    return [
        *tables(rows),
        f"{result['driven_min']:.1f} minutes, activities: {done}",
        f"nearest to an obstacle {1e3 * result['least_gap_m']:.0f} mm: {met['contact']}",
        f"fastest {result['fastest_m_s']:.2f} m/s, at most {result['speed_limit_m_s']:.2f} m/s: "
        f"{met['speed']}",
        f"processes that ended: {', '.join(result['ended']) or 'none'}: {met['processes']}",
        f"resets and services: {result['stuck'] or 'all worked'}: {met['reset']}",
        f"calls of services without an answer: {len(result['unanswered'])}",
        f"stops without a fault: {len(result['false_stops'])}: {met['false_stops']}; "
        f"{result['held_up_stops']} more while the machine held a process up",
        f"descriptors and threads: {met['counts']}; memory: {met['memory']}; load "
        f"{result['load']:.1f} on {os.cpu_count()} cores",
    ]
