"""`omniman demo`: a simulated robot drives a show, is measured, and can be kept for teleop."""

import argparse
import os
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.node import Node

from omniman_ros.cli import results
from omniman_ros.cli.children import Children, Exit, signals_to
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.figures import Pace
from omniman_ros.cli.fleet import Setup, resolved, tasks
from omniman_ros.cli.isolation import isolate
from omniman_ros.cli.output import NodeLog
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.recorder import Recording
from omniman_ros.cli.score import LIMITS, DrivenGoal, DrivenLeg, DrivenTwist, judge
from omniman_ros.cli.session import ANNOUNCED, Session
from omniman_ros.cli.show import Show
from omniman_ros.cli.terminal import GREEN, RED, paint, say, table
from omniman_ros.cli.tool_leg import ToolTrack
from omniman_ros.core.body.model import BodyModel, Mount
from omniman_ros.core.limits import TwistLimits
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.robots import load_robot

LIMP = "drive.dead_wheel:=drive_on"
"""The show loses a wheel and goes on."""
PATIENT = (
    "timeouts.wheel_states:=0.5", "firmware.watchdog:=0.5", "safety.deadline:=0.05",
    "odom_timeout:=1.0", "can.missed_periods:=100", "can.drive_heartbeat:=0.2",
    "can.heartbeat_timeout:=0.5", "can.command_timeout:=0.5",
    "joint_trajectory.states_timeout:=1.0", "scaling_timeout:=2.0", "ur.following_error:=0.5",
)  # fmt: skip
"""A show on a busy machine: nothing real is at stake when a process waits for its turn."""


PAGE = re.compile(r"the page is at (http\S+)")
"""What the viewer says when it is up."""
PAGE_PATIENCE = 10.0
"""How long to wait for the viewer's page [s]."""


def run(args: argparse.Namespace) -> int:
    """Run `omniman demo`; returns the exit code."""
    params = [*PATIENT, LIMP, *unlike_wheels(resolved(args.robot)), *args.param]
    private = choose_domain(args.keep)  # before the nodes: their bus is one of the domain
    chosen = tasks(
        Setup(
            robot=args.robot,
            params=params,
            drive=args.drive,
            installation=args.installation,
            arm=args.arm,
        )  # fmt: skip
    )
    log = NodeLog(args.verbose)
    complaints: list[str] = []
    children = Children(chosen, on_line=log, report=complaints.append)
    progress = Progress()
    progress.headline(
        f"omniman demo: robot '{args.robot}' in simulation, its wheels not alike, "
        + (f"{args.installation} drives on a CAN bus, " if args.drive == "can" else "")
        + ("" if args.arm == "none" else "a UR5 behind TCP, ")
        + f"ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']}"
    )
    started = time.monotonic()
    with signals_to(children.interrupt):
        try:
            if not private:
                refuse_other_robots(children.check)
            with children:
                viewer = log if any(task.name == "viewer" for task in chosen) else None
                result = perform(args, children, progress, viewer)
                result["duration_s"] = time.monotonic() - started
                if args.keep:
                    keep(children, result)
                children.stop()
        except (CommandError, KeyboardInterrupt) as error:
            progress.abandon()
            for complaint in complaints:
                say(complaint, sys.stderr)
            if isinstance(error, CommandError):
                log.show()
            raise
    result["faults"] += complaints
    return conclude(result, log, args)


def choose_domain(keep: bool) -> bool:
    """Set this process's ROS domain, which the nodes inherit; returns whether it is private.

    The show gets a domain of its own, so that it meets no robot. With --keep it uses the domain
    that the user's next terminal will use. In both it is not seen beyond this machine, unless
    the user has said otherwise: nobody's robot elsewhere hears the show's cmd_vel.
    """
    if keep:
        os.environ.setdefault("ROS_DOMAIN_ID", "0")
    private = "ROS_DOMAIN_ID" not in os.environ
    isolate(os.environ)
    return private


def refuse_other_robots(check: Callable[[], None]) -> None:
    """Look around in a domain that is not the demo's own, before there are nodes of its own.

    Raises:
        CommandError: A robot is there: it would drive the show too, and its drive and this one
            would speak on the same topics.
    """

    def robot_there() -> bool:
        check()
        return robots_in(session.node)

    with Session("omniman_demo") as session:
        if session.wait(robot_there, ANNOUNCED):
            raise CommandError(
                "another robot is in this ROS domain (a node that was killed is seen for 20 s): "
                "end it, or choose another ROS_DOMAIN_ID"
            )


def robots_in(node: Node) -> bool:
    """Whether somebody publishes wheel commands or listens to cmd_vel."""
    return bool(node.count_publishers("wheel_commands") or node.count_subscribers("cmd_vel"))


def perform(
    args: argparse.Namespace, children: Children, progress: Progress, viewer: NodeLog | None
) -> dict[str, Any]:
    """Drive the show and judge it; where there is a viewer, its page is there before it begins."""
    lost = expendable(resolved(args.robot))
    pace = Pace.within(build(TwistLimits, load_robot(args.robot), "limits."))
    model = BodyModel(build(Mount, load_robot(args.robot), "mount."))
    with Session("omniman_demo") as session:
        show = Show(session, pace, progress, children.check, args.drive, args.arm != "none")
        try:
            show.meet()
            page = ""
            if viewer is not None:
                show.wait(lambda: bool(viewer.find("viewer", PAGE)), PAGE_PATIENCE)
                page = viewer.find("viewer", PAGE)
                progress.headline(watch(page))
            show.drive_twists()
            show.follow_path()
            if args.arm != "none":
                show.lead_tool(model)
            show.reach_goal()
            if lost:
                show.drive_without_a_wheel(lost)
            show.stop_in_an_emergency()
        finally:
            show.halt()
        recording, driven = show.recorder.recording, show.driven
        body = build(Robot, load_robot(args.robot)).body
        half = (0.5 * body.length, 0.5 * body.width)
        tool = ToolTrack(recording, model, driven.tool) if driven.tool else None
        result = judge(
            recording, driven.twists, driven.legs, driven.without_wheel, driven.goal, half,
            driven.arm, tool, driven.stop,
        )  # fmt: skip
    limped = [driven.without_wheel.leg] if driven.without_wheel else []
    drawn = draw(args, recording, driven.twists, driven.legs + limped, driven.goal, tool)
    return {"robot": args.robot, **result, "picture": drawn and str(drawn), "page": page}


def watch(page: str) -> str:
    """Where to look at the robot."""
    return f"watch it at {page}" if page else "the viewer has no page (see --verbose)"


def draw(
    args: argparse.Namespace,
    recording: Recording,
    twists: list[DrivenTwist],
    legs: list[DrivenLeg],
    goal: DrivenGoal | None,
    tool: ToolTrack | None,
) -> Path | None:
    """Draw the show into a PNG file, where there is matplotlib."""
    try:
        from omniman_ros.cli import picture
    except ImportError:
        return None
    path = Path(args.results) / "demo.png"
    picture.draw(build(Robot, load_robot(args.robot)), recording, twists, legs, path, goal, tool)
    return path


def expendable(robot: str) -> str:
    """The wheel that the show drives without; empty where no wheel can be spared."""
    names = build(Robot, load_robot(robot)).wheels.names
    return names[-1] if len(names) > 3 else ""


def unlike_wheels(robot: str) -> list[str]:
    """Parameters that make the simulated wheels differ, as real ones do (CCTA 2017, V.C)."""
    n = build(Robot, load_robot(robot)).wheel_count
    factors = {
        "mismatch.friction": (1.3, 0.8, 1.1, 0.9),
        "mismatch.torque_constant": (0.97, 1.03, 1.0, 0.98),
        "mismatch.amplifier_gain": (1.02, 0.98, 1.01, 0.97),
    }
    return [
        f"{name}:=[{', '.join(str(values[i % len(values)]) for i in range(n))}]"
        for name, values in factors.items()
    ]


def keep(children: Children, result: dict[str, Any]) -> None:
    """Leave the nodes up until Ctrl-C.

    Raises:
        CommandError: One of them died.
    """
    say("\n".join(report(result)))
    if result["faults"]:
        say("\n" + complaint(result["faults"]))
    page = result["page"]
    program = Path(sys.executable).with_name("omniman")
    domain = os.environ["ROS_DOMAIN_ID"]
    setting = "" if domain == "0" else f"ROS_DOMAIN_ID={domain} "
    say(f"""
The robot stays up{f": {watch(page)}" if page else ""}. In another terminal on this machine:
  {setting}{program} teleop
  {setting}{program} stop       (and: reset)
or with ROS 2:
  {setting}ros2 run teleop_twist_keyboard teleop_twist_keyboard
Ctrl-C here ends it.""")
    event = children.next_event()
    if isinstance(event, Exit):
        raise CommandError(str(event))


def complaint(faults: list[str]) -> str:
    """What the robot did not do as it should."""
    head = paint("The robot did not do what it should:", RED, sys.stdout)
    return "\n".join([head, *(f"  {fault}" for fault in faults)])


def report(result: dict[str, Any]) -> list[str]:
    """The table at the end."""
    track, drift, timing = result["tracking"], result["odometry"], result["timing"]
    worst = max(result["twists"], key=lambda twist: twist["linear_m_s"])
    odom, commands = timing["odom"], timing["wheel_commands"]
    rows: list[tuple[str, ...]] = [
        ("", "value", "limit"),
        ("tracking error in odom, RMS", f"{track['rms_mm']:.2f} mm",
         f"{LIMITS['tracking RMS, mm']:g} mm"),
        ("tracking error in odom, max", f"{track['max_mm']:.2f} mm",
         f"{LIMITS['tracking max, mm']:g} mm"),
        ("heading error, RMS", f"{track['heading_rms_deg']:.2f} deg", ""),
        ("pose at the end of the path", f"{track['final_mm']:.2f} mm",
         f"{LIMITS['final position, mm']:g} mm"),
        (f"twist error, worst ({worst['name']})", f"{1e3 * worst['linear_m_s']:.1f} mm/s",
         f"{1e3 * LIMITS['twist error, m/s']:g} mm/s"),
        ("coupling error, RMS / max", f"{result['coupling']['rms_rad']:.4f} / "
         f"{result['coupling']['max_rad']:.4f} rad", ""),
        (f"odometry off the truth after {drift['travel_m']:.1f} m",
         f"{drift['position_mm']:.1f} mm", f"{LIMITS['odometry position, mm']:g} mm"),
        (f"heading off the truth after {drift['turn_rad']:.1f} rad",
         f"{drift['heading_deg']:.2f} deg", f"{LIMITS['odometry heading, deg']:g} deg"),
        *of_arm(result),
        *of_tool(result),
        *to_goal(result),
        *without_wheel(result),
        *in_an_emergency(result),
        ("energy taken by the motors", f"{result['energy']['total_j']:.0f} J", ""),
        ("odom: rate, interval p50 / p99", f"{odom['rate_hz']:.1f} Hz, {odom['p50_ms']:.2f} / "
         f"{odom['p99_ms']:.2f} ms", f"{LIMITS['odom rate, Hz']:g} Hz"),
        ("wheel_commands: rate, p50 / p99", f"{commands['rate_hz']:.1f} Hz, "
         f"{commands['p50_ms']:.2f} / {commands['p99_ms']:.2f} ms",
         f"{LIMITS['wheel_commands rate, Hz']:g} Hz"),
    ]  # fmt: skip
    return ["", *table(rows)]


def of_arm(result: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the arm, where there was one."""
    if "arm" not in result:
        return []
    arm = result["arm"]
    sent = arm["setpoints"]
    return [
        (f"arm after {arm['moves']} moves: off by, worst joint", f"{arm['final_mrad']:.2f} mrad",
         f"{LIMITS['arm final position, mrad']:g} mrad"),
        ("  on the way, RMS; behind by", f"{arm['rms_mrad']:.2f} mrad, {arm['lag_ms']:.0f} ms",
         f"{LIMITS['arm off its path, mrad']:g} mrad, "
         f"{LIMITS['arm behind its reference, ms']:g} ms"),
        ("  setpoints by TCP: interval p50 / p99", f"{sent['p50_ms']:.2f} / {sent['p99_ms']:.2f} "
         "ms", ""),
    ]  # fmt: skip


def of_tool(result: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the path of the tool, where there was one."""
    if "tool" not in result:
        return []
    tool = result["tool"]
    return [
        (f"tool on a path of {tool['length_m']:.1f} m, timed: off by RMS / max",
         f"{tool['rms_mm']:.2f} / {tool['max_mm']:.2f} mm",
         f"{LIMITS['tool off its path RMS, mm']:g} / {LIMITS['tool off its path max, mm']:g} mm"),
        ("  by the ground truth (odometry's drift is in it)",
         f"{tool['true_rms_mm']:.2f} / {tool['true_max_mm']:.2f} mm", ""),
    ]  # fmt: skip


def to_goal(result: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the goal among obstacles."""
    if "goal" not in result:
        return []
    goal = result["goal"]
    return [
        (f"goal among obstacles, after {goal['time_s']:.1f} s: off by",
         f"{goal['position_mm']:.0f} mm, {goal['heading_deg']:.1f} deg",
         f"{LIMITS['goal position, mm']:g} mm, {LIMITS['goal heading, deg']:g} deg"),
        ("  least gap to an obstacle", f"{1e3 * goal['clearance_m']:.0f} mm", "above 0"),
    ]  # fmt: skip


def without_wheel(result: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the part that is driven without a wheel, where there was one."""
    if "dead_wheel" not in result:
        return []
    dead = result["dead_wheel"]
    return [
        (f"wheel '{dead['wheel']}' without torque: noticed", f"{dead['noticed_s']:.2f} s",
         f"{LIMITS['dead wheel noticed, s']:g} s"),
        ("  driving on without it, RMS", f"{dead['rms_mm']:.2f} mm",
         f"{LIMITS['tracking without a wheel RMS, mm']:g} mm"),
    ]  # fmt: skip


def in_an_emergency(result: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the emergency stop, where there was one."""
    if "emergency_stop" not in result:
        return []
    stop = result["emergency_stop"]
    rows: list[tuple[str, ...]] = [
        (f"emergency stop at {stop['speed_m_s']:.2f} m/s: at rest after, way",
         f"{stop['rest_s']:.2f} s, {stop['way_mm']:.0f} mm",
         f"{LIMITS['at rest after an emergency stop, s']:g} s"),
    ]  # fmt: skip
    if "arm_rest_s" in stop:
        rows.append(
            (f"  arm at {stop['arm_rate_rad_s']:.2f} rad/s: at rest after",
             f"{stop['arm_rest_s']:.2f} s",
             f"{LIMITS['arm at rest after an emergency stop, s']:g} s")
        )  # fmt: skip
    rows.append(
        ("  moved in the second after the reset", f"{stop['moved_mm']:.2f} mm",
         f"{LIMITS['moved after the reset, mm']:g} mm")
    )  # fmt: skip
    return rows


def conclude(result: dict[str, Any], log: NodeLog, args: argparse.Namespace) -> int:
    """Print the table (unless it was), the verdict, and the JSON; returns the exit code."""
    good = not result["faults"]
    if not args.keep:
        say("\n".join(report(result)))
    if result["picture"]:
        say(f"\nPicture: {result['picture']}")
    if good:
        say("\n" + paint("The robot did what it should.", GREEN, sys.stdout)
            + f" {result['duration_s']:.0f} s")  # fmt: skip
    else:
        log.show()
        say("\n" + complaint(result["faults"]))
    results.publish("demo", {"ok": good, **result}, args.results)
    return 0 if good else 1
