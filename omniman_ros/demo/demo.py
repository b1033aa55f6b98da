"""The demo as a list of legs, and the evaluation of its result."""

from collections.abc import Sequence
from typing import Any

from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.demo.arm_moves import ARM_LIMITS, ArmMove, arm_figures
from omniman_ros.demo.dead_wheel_leg import DeadWheelLeg
from omniman_ros.demo.driver import Driver
from omniman_ros.demo.goal_leg import GoalLeg
from omniman_ros.demo.leg import Leg
from omniman_ros.demo.limits import Limit, violations
from omniman_ros.demo.path_leg import PathLeg
from omniman_ros.demo.recorder import Recording
from omniman_ros.demo.stop_leg import StopLeg
from omniman_ros.demo.tool_leg import ToolLeg
from omniman_ros.demo.twist_leg import Pace, TwistLeg
from omniman_ros.demo.whole_drive import WHOLE_DRIVE_LIMITS, whole_drive_figures
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel
from omniman_ros.robots import load_robot

LIMITS: tuple[Limit, ...] = (
    *PathLeg.limits,
    *WHOLE_DRIVE_LIMITS,
    *GoalLeg.limits,
    *ARM_LIMITS,
    *ToolLeg.limits,
    *DeadWheelLeg.limits,
    *StopLeg.limits,
    *TwistLeg.limits,
)
"""All limits of the demo."""


class Demo:
    """The legs of the demo of one robot, in the order in which they are driven.

    Args:
        robot: Name of the robot, or path of its file.
        has_arm: Whether the robot has an arm.
        by_scanner: Whether it drives to the goal by its scanner, among the persons of a world.

    Attributes:
        robot: Parameters of the robot.
        twists: Leg that is driven through `cmd_vel`.
        path: Leg that follows the path of CCTA 2017, Fig. 7.
        tool: Leg that moves the tool along a path; None if the robot has no arm.
        goal: Leg that drives to a goal among obstacles.
        dead_wheel: Leg with a dead wheel; None if no wheel can be spared.
        stop: Leg with the emergency stop.
    """

    def __init__(self, robot: str, has_arm: bool = True, *, by_scanner: bool = False) -> None:
        parameters = load_robot(robot)
        self.robot = build(Robot, parameters)
        body = self.robot.body
        pace = Pace.within(build(TwistLimits, parameters, "limits."))
        wheel = expendable_wheel(self.robot)
        self.twists = TwistLeg(pace)
        self.path = PathLeg()
        self.tool = (
            ToolLeg(WholeBodyModel(build(Mount, parameters, "mount."))) if has_arm else None
        )
        self.goal = GoalLeg((0.5 * body.length, 0.5 * body.width), by_scanner=by_scanner)
        self.dead_wheel = DeadWheelLeg(wheel) if wheel else None
        self.stop = StopLeg(pace.speed)

    @property
    def legs(self) -> list[Leg]:
        """The legs, in the order in which they are driven."""
        legs = (self.twists, self.path, self.tool, self.goal, self.dead_wheel, self.stop)
        return [leg for leg in legs if leg is not None]

    def drive(self, driver: Driver) -> None:
        """Drive all legs; stalls of the machine are measured from here on.

        Raises:
            CommandError: The robot did not do what was asked, or stopped.
        """
        driver.restart_stall_watch()
        for leg in self.legs:
            leg.drive(driver)


def judge(
    recording: Recording, legs: Sequence[Leg], arm_moves: Sequence[ArmMove] = ()
) -> dict[str, Any]:
    """Return all figures of the demo, and those that are beyond their limits.

    Args:
        recording: What the robot published.
        legs: Legs that have been driven.
        arm_moves: Moves of the arm that are measured.

    Returns:
        Figures by section, and under `faults` a sentence for each figure beyond its limit.
    """
    result: dict[str, Any] = {}
    for leg in legs:
        result |= leg.measure(recording)
    if arm_moves:
        result["arm"] = arm_figures(recording, arm_moves)
    result |= whole_drive_figures(recording)
    result["faults"] = [text + recording.stall_note for text in violations(result, LIMITS)]
    return result


def expendable_wheel(robot: Robot) -> str:
    """Return the name of a wheel without which the robot can drive; empty if there is none."""
    names = robot.wheels.names
    return names[-1] if len(names) > 3 else ""
