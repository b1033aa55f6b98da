"""`omniman demo`: drive and measure a simulated robot; keep it running for teleop if asked."""

import argparse
import os
import re
import sys
import time
from pathlib import Path
from typing import Any

from omniman_ros.console import results
from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import GREEN, paint, say
from omniman_ros.core.errors import OmnimanError
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.demo.demo import drive, judge, load_demo
from omniman_ros.demo.driver import DemoDriver
from omniman_ros.demo.report import fault_lines, report_lines
from omniman_ros.extras import TRACKING, WORLD
from omniman_ros.nodes.clock_follower import ClockFollower
from omniman_ros.processes.checked_parameters import robot_values
from omniman_ros.processes.node_output import NodeOutputLog
from omniman_ros.processes.other_robots import refuse_other_robots
from omniman_ros.processes.process_group import ProcessExit, ProcessGroup, redirect_signals
from omniman_ros.processes.robot_setup import RobotSetup, resolve_robot, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.simulation.scene_files import load_scene

#: Parameter value with which the robot continues when a wheel is dead
DRIVE_ON = "drive.dead_wheel:=drive_on"
DEMO_WORLD = "hall"  #: Scene in which the demo drives if none is named
WORLD_ROBOT = "omniman"  #: Robot that drives there: the scene has room for it
NO_WORLD = "none"  #: Value of `--world` with which the demo drives on the plant
#: Parameters with which wheels in a world roll as odometry assumes that nobody has calibrated: on
#: rollers, a platform loses 1 to 2 % of its way sideways, and tyres of 1e6 N/m sink, which makes
#: the rolling radius 0.16 % smaller.
WORLD_WHEELS = ("world.wheels:=ideal", "world.tyre_stiffness:=1.0e7")
#: Parameters with which the scanner at the robot's front sees 270 degrees, at a rate that leaves
#: the processor to the robot on a small machine.
SCANNER = ("scanners.field_of_view:=[4.71238898]", "scanners.rate:=[10.0]", "map_rate:=2.0")
WHEEL_DIFFERENCES = {
    "mismatch.friction": (1.3, 0.8, 1.1, 0.9),
    "mismatch.torque_constant": (0.97, 1.03, 1.0, 0.98),
    "mismatch.amplifier_gain": (1.02, 0.98, 1.01, 0.97),
}  #: Parameters by which the simulated wheels differ: a factor for each wheel, in turn
#: Log line of the viewer that gives the address of its page
PAGE_PATTERN = re.compile(r"the page is at (http\S+)")
#: How far simulated time may be ahead of this process, which commands and measures [s]
LOOKAHEAD = 0.02
PAGE_TIMEOUT = 10.0  #: Time to wait for the viewer's page [s]


def run(args: argparse.Namespace) -> int:
    """Run `omniman demo`; the exit code is 0 if all figures are within their limits, else 1.

    Raises:
        CommandError, OmnimanError: The demo could not be completed.
    """
    setup = demo_setup(args)
    # The domain is chosen before the processes, because the port of their CAN bus depends on it.
    is_private = choose_domain(args.keep)
    processes = robot_processes(setup)
    log = NodeOutputLog(args.verbose)
    complaints: list[str] = []
    group = ProcessGroup(processes, on_line=log, report=complaints.append)
    progress = Progress()
    progress.headline(
        f"omniman demo: robot '{args.robot}' in simulation, with unequal wheels, "
        + (f"in the world {setup.world}, " if setup.world else "")
        + (f"{args.installation} drives on a CAN bus, " if args.drive == "can" else "")
        + ("" if args.arm == "none" else "a UR5 behind TCP, ")
        + f"ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']}"
    )
    started = time.monotonic()
    with redirect_signals(group.interrupt):
        try:
            if not is_private:
                refuse_other_robots(group.check)
            with group:
                viewer = log if any(process.name == "viewer" for process in processes) else None
                result = perform(setup, Path(args.results), group, progress, viewer)
                result["duration_s"] = time.monotonic() - started
                if args.keep:
                    keep(group, result)
                group.stop()
        except (CommandError, OmnimanError, KeyboardInterrupt) as error:
            progress.abandon()
            for complaint in complaints:
                say(complaint, sys.stderr)
            if not isinstance(error, KeyboardInterrupt):
                log.show()
            raise
    result["faults"] += complaints
    return conclude(result, log, args)


def demo_setup(args: argparse.Namespace) -> RobotSetup:
    """Return the robot of the demo.

    Raises:
        CommandError: The robot does not exist.
    """
    world = demo_world(args)
    params = [
        *((*WORLD_WHEELS, *SCANNER) if world else ()),
        DRIVE_ON,
        *wheel_differences(resolve_robot(args.robot)),
        *args.param,
    ]
    return RobotSetup(
        robot=args.robot,
        params=params,
        drive=args.drive,
        installation=args.installation,
        arm=args.arm,
        sim_time=True,
        world=world,
        obstacle_tracker=world is not None and TRACKING.is_available,
        whole_body_planner=args.arm != "none",
    )


def demo_world(args: argparse.Namespace) -> str | None:
    """Return the scene of the physics world in which the demo drives; None for the plant.

    Without `--world`, the package's own robot drives in a world where all is installed that it
    needs to see by its scanner.
    """
    if args.world is not None:
        return None if args.world == NO_WORLD else str(args.world)
    can_see = WORLD.is_available and TRACKING.is_available
    fits = args.robot == WORLD_ROBOT and args.drive == "simulated"
    return DEMO_WORLD if can_see and fits else None


def choose_domain(keep: bool) -> bool:
    """Set the ROS domain of this process, which the nodes inherit; return whether it is private.

    By default the demo uses a domain of its own, so that it meets no other robot. With --keep it
    uses the domain that the user's next terminal will use. In both cases it is invisible to other
    machines unless the user has chosen otherwise: no robot elsewhere receives its `cmd_vel`.
    """
    if keep:
        os.environ.setdefault("ROS_DOMAIN_ID", "0")
    is_private = "ROS_DOMAIN_ID" not in os.environ
    isolate_ros_domain(os.environ)
    return is_private


def perform(
    setup: RobotSetup,
    folder: Path,
    group: ProcessGroup,
    progress: Progress,
    viewer: NodeOutputLog | None,
) -> dict[str, Any]:
    """Drive all legs of the demo, evaluate and draw them.

    Args:
        group: Processes of the nodes, which must stay alive.
        viewer: Log in which the viewer announces its page, for which the robot waits; None if no
            viewer is started.

    Returns:
        The figures, with the path of the picture and the address of the page.

    Raises:
        CommandError, OmnimanError: The robot did not complete the demo.
    """
    has_arm = setup.arm != "none"
    posts = load_scene(setup.world).posts if setup.world else ()
    demo = load_demo(setup.robot, has_arm, by_scanner=setup.obstacle_tracker, posts=posts)
    with Session("omniman_demo", sim_time=True) as session:
        driver = DemoDriver(session, progress, group.check, setup.wheel_drive, has_arm)
        # It takes the timer of the driver's client, which keeps step with simulated time.
        pace = ClockFollower(session.node, LOOKAHEAD, lambda: None, session.now)
        try:
            with driver.robot:
                driver.wait_until_ready()
                page = ""
                if viewer is not None:
                    driver.wait(lambda: bool(viewer.find("viewer", PAGE_PATTERN)), PAGE_TIMEOUT)
                    page = viewer.find("viewer", PAGE_PATTERN)
                    progress.headline(page_hint(page))
                drive(demo, driver)
        finally:
            pace.leave()
        recording = driver.recorder.recording
        result = judge(demo, recording)
    try:
        from omniman_ros.demo.picture import draw_demo

        picture = str(draw_demo(demo, recording, folder / "demo.png"))
    except ImportError:  # without matplotlib, there is no picture
        picture = None
    return {"robot": setup.robot, **result, "picture": picture, "page": page}


def page_hint(page: str) -> str:
    """Return where to watch the robot: the address of the viewer's page, if it has one."""
    return f"watch it at {page}" if page else "the viewer has no page (see --verbose)"


def wheel_differences(robot: str) -> list[str]:
    """Return parameters that make the simulated wheels differ, like real ones (CCTA 2017, V.C).

    Raises:
        CommandError: The robot's file cannot be used.
    """
    try:
        n = build(Platform, robot_values(robot)).wheel_count
    except OmnimanError as error:
        raise CommandError(str(error), 2) from error
    return [
        f"{name}:=[{', '.join(str(values[i % len(values)]) for i in range(n))}]"
        for name, values in WHEEL_DIFFERENCES.items()
    ]


def keep(group: ProcessGroup, result: dict[str, Any]) -> None:
    """Print the result, and leave the nodes running until Ctrl-C.

    Raises:
        CommandError: One of the nodes ended.
    """
    say("\n".join(report_lines(result)))
    if result["faults"]:
        say("\n" + fault_lines(result["faults"]))
    page = result["page"]
    executable = Path(sys.executable).with_name("omniman")
    domain = os.environ["ROS_DOMAIN_ID"]
    setting = "" if domain == "0" else f"ROS_DOMAIN_ID={domain} "
    say(f"""
The robot stays up{f": {page_hint(page)}" if page else ""}. In another terminal on this machine:
  {setting}{executable} teleop
  {setting}{executable} stop       (and: reset)
or with ROS 2:
  {setting}ros2 run teleop_twist_keyboard teleop_twist_keyboard
Ctrl-C here ends it.""")
    event = group.next_event()
    if isinstance(event, ProcessExit):
        raise CommandError(str(event))


def conclude(result: dict[str, Any], log: NodeOutputLog, args: argparse.Namespace) -> int:
    """Print the result unless `keep` has done so, write it as JSON, and return the exit code.

    The output of the nodes is printed if a figure is beyond its limit.
    """
    ok = not result["faults"]
    if not args.keep:
        say("\n".join(report_lines(result)))
    if result["picture"]:
        say(f"\nPicture: {result['picture']}")
    if ok:
        verdict = paint("The robot did what it should.", GREEN, sys.stdout)
        say(f"\n{verdict} {result['duration_s']:.0f} s")
    else:
        log.show()
        say("\n" + fault_lines(result["faults"]))
    say(f"Figures: {results.save('demo', {'ok': ok, **result}, args.results)}")
    return 0 if ok else 1
