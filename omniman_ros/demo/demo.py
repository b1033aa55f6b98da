"""The demo of one robot: its legs in their order, and the evaluation of its result."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.demo import figures, legs
from omniman_ros.demo.driver import DemoDriver
from omniman_ros.demo.measures import Interval, violations
from omniman_ros.demo.recorder import DemoRecording
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.world.scene import Post


@dataclass
class Demo:
    """A robot, and what it has driven, leg by leg; legs that were not driven are empty or None."""

    description: DescriptionParameters  #: Shape of the robot
    pace: legs.DemoSpeeds
    model: WholeBodyModel | None  #: Platform and arm; None if the robot has no arm
    by_scanner: bool  #: Whether it drives by its scanner, among the persons of a world
    posts: Sequence[Post] = ()  #: Posts of that world
    twists: list[figures.TwistPhase] = field(default_factory=list)  #: Driven through `cmd_vel`
    movements: list[Interval] = field(default_factory=list)  #: Path of CCTA 2017, Fig. 7
    arm_moves: list[figures.ArmMove] = field(default_factory=list)
    tool: figures.DrivenTool | None = None
    goal: figures.DrivenGoal | None = None
    dead_wheel: legs.DeadWheel | None = None
    stop: figures.DrivenStop | None = None

    @property
    def robot(self) -> Platform:
        """Wheels and body."""
        return self.description.robot

    @property
    def half_size(self) -> tuple[float, float]:
        """Half length and half width of the robot's bounding box [m]."""
        return 0.5 * self.robot.body.length, 0.5 * self.robot.body.width

    @property
    def path_intervals(self) -> list[Interval]:
        """Intervals in which the platform followed a path."""
        return self.movements + ([self.dead_wheel.interval] if self.dead_wheel else [])


def load_demo(
    robot: str,
    has_arm: bool = True,
    *,
    by_scanner: bool = False,
    posts: Sequence[Post] = (),
) -> Demo:
    """Return the demo of a robot, given by its name or the path of its file."""
    parameters = robot_parameters(robot)
    description = build(DescriptionParameters, parameters)
    model = WholeBodyModel(description.mount) if has_arm else None
    pace = legs.DemoSpeeds.within(build(TwistLimits, parameters, "limits."))
    return Demo(description, pace, model, by_scanner, posts)


def drive(demo: Demo, driver: DemoDriver) -> None:
    """Drive all legs; stalls of the machine are measured from here on.

    Raises:
        CommandError, OmnimanError: The robot did not do what was asked, or stopped.
    """
    driver.restart_stall_watch()
    demo.twists = legs.drive_twists(driver, demo.pace)
    demo.movements, demo.arm_moves = legs.drive_path(driver)
    if demo.model is not None:
        demo.tool, move = legs.drive_tool(driver, demo.posts)
        demo.arm_moves.append(move)
    demo.goal = legs.drive_to_goal(driver, demo.by_scanner)
    if wheel := expendable_wheel(demo.robot):
        demo.dead_wheel = legs.drive_with_dead_wheel(driver, wheel)
    demo.stop = legs.drive_and_stop(driver, demo.pace.speed)


def judge(demo: Demo, recording: DemoRecording) -> dict[str, Any]:
    """Return all figures by section; under `faults` is a sentence for each beyond its limit."""
    odom, reference = np.array(recording.odom), figures.Reference(recording.reference)
    result: dict[str, Any] = {
        "twists": figures.twist_figures(odom, demo.twists),
        "tracking": figures.tracking_figures(odom, reference, demo.movements),
        "coupling": figures.coupling_figures(recording.coupling, demo.movements),
    }
    if demo.model is not None and demo.tool:
        track = figures.tool_track(recording, demo.model, demo.tool.interval)
        result["tool"] = figures.tool_figures(track)
        if demo.tool.has_obstacles:
            gap = figures.tool_clearance(track, demo.description, demo.tool)
            result["tool"]["clearance_m"] = gap
    if demo.goal:
        truth = np.array(recording.truth)
        result["goal"] = figures.goal_figures(odom, truth, demo.goal, demo.half_size)
    if demo.dead_wheel:
        result["dead_wheel"] = {
            "wheel": demo.dead_wheel.wheel,
            "noticed_s": demo.dead_wheel.delay,
            **figures.tracking_figures(odom, reference, [demo.dead_wheel.interval]),
        }
    if demo.stop:
        result["emergency_stop"] = figures.stop_figures(recording, demo.stop)
    if demo.arm_moves:
        result["arm"] = figures.arm_figures(recording, demo.arm_moves)
    result |= figures.whole_drive_figures(recording)
    result["faults"] = [text + recording.stall_note for text in violations(result)]
    return result


def expendable_wheel(robot: Platform) -> str:
    """Return the name of a wheel without which the robot can drive; empty if there is none."""
    names = robot.wheels.names
    return names[-1] if len(names) > 3 else ""
