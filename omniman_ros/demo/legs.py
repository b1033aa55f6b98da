"""The legs of the demo: each drives the robot from its present pose until it is at rest.

Each raises a `CommandError`, or an error of the client, if the robot does not do what is asked,
or stops.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.control.limits import TwistLimits
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.demo.driver import PAUSE, SERVICE_TIMEOUT, DemoDriver
from omniman_ros.demo.figures import ArmMove, DrivenGoal, DrivenStop, DrivenTool, TwistPhase
from omniman_ros.demo.measures import Interval
from omniman_ros.demo.moving_obstacles import DemoObstacles
from omniman_ros.demo.perception import People
from omniman_ros.motion.figure7 import Movement, movements
from omniman_ros.simulation.world.scene import Post

MAX_SPEED = 0.3  #: Largest linear speed of the twists [m/s]
MAX_YAW_RATE = 0.8  #: Largest yaw rate of the twists [rad/s]
LAP_TIME = 5.0  #: Time for the circle [s]

SLOWEST_SPEED = 0.1  #: Mean speed below which a motion is given up [m/s]
EXTRA_TIME = 20.0  #: Time that a motion may take beyond its length at `SLOWEST_SPEED` [s]
SPACING = 0.02  #: Largest horizontal distance between two poses of a path [m]
ARM_POSES = (
    (0.6, -0.5, 0.9, -0.4, 0.4, 0.8),
    (-0.5, -0.2, 0.4, -0.8, -0.6, -0.7),
    (0.3, -0.7, 0.2, 0.5, 0.7, 0.4),
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
)  #: Joint angles to which the arm moves in each movement, relative to those at the start [rad]

ARM_MOVE_TIME = 2.5  #: Duration of a measured move of the arm, within its limits [s]
ARM_TIMEOUT = 10.0  #: Time within which the arm must have arrived [s]

#: Joint angles for the tool's path: arm bent, tool pointing down in front of the robot [rad]
START_ANGLES = (0.0, -1.9, 2.0, -1.7, -1.57, 0.0)
LENGTH = 3.0  #: Length of the tool's path, which seen from above is straight [m]
WAVE_HEIGHT = 0.06  #: Height between the highest and the lowest point of the tool's path [m]
WAVES = 2.0  #: Number of waves of its height

#: Pose of the goal in a world, in odom [m, m, rad]: the robot has evaded what is in its way, and
#: stands here or there
GOAL_IN_WORLD = (0.45, -4.5, -0.07)
#: Pose of the goal elsewhere, beyond the obstacles, in the robot's frame at the start [m, m, rad]
GOAL = (3.2, 0.3, 1.5707963)
GOAL_TIMEOUT = 60.0  #: Time within which the goal must be reached [s]: persons hold the robot up
NOTICE_TIME = 0.5  #: Time before the goal in which the robot hears of the obstacles [s]

EDGE = 0.5  #: Length of each of the two straights that are driven with a dead wheel [m]
FAULT_PROGRESS = 0.15  #: Progress on this path at which the motor loses its torque
DRIVING = "driving"  #: State of a healthy wheel in `wheel_health`

DRIVING_TIME = 1.2  #: Time for which the robot drives before the emergency stop [s]
STOPPED_TIME = 1.5  #: Time for which twists are still sent while the stop is pressed [s]
WATCHED_TIME = 1.0  #: Time for which the robot is watched after the reset [s]
ARM_SWING = np.array([0.9, 0.0, 0.0, 0.0, 0.0, 1.2])  #: Change of the arm's joint angles [rad]
ARM_SWING_TIME = 3.0  #: Time that this change would take without the stop [s]

# ---- twists through `cmd_vel` --------------------------------------------------------------


@dataclass(frozen=True)
class DemoSpeeds:
    """Speeds of the demo, well within the limits of a robot."""

    speed: float = 0.3  #: Linear [m/s]
    yaw_rate: float = 0.6  #: [rad/s]

    @classmethod
    def within(cls, limits: TwistLimits) -> "DemoSpeeds":
        """Return the pace for the limits of a robot."""
        return cls(
            speed=min(MAX_SPEED, 0.5 * limits.linear_velocity),
            yaw_rate=min(MAX_YAW_RATE, 0.5 * limits.angular_velocity),
        )


def twist_phases(pace: DemoSpeeds) -> list[TwistPhase]:
    """Return the phases: a diagonal, a rotation on the spot, and a circle with rotation."""
    speed, turning = pace.speed, 0.75 * pace.yaw_rate
    diagonal = speed / math.sqrt(2.0)
    # The direction of travel rotates in base_link so that the path is a circle in the world.
    course_rate = math.tau / LAP_TIME - turning

    def circle(t: float) -> Triple:
        return speed * math.cos(course_rate * t), speed * math.sin(course_rate * t), turning

    return [
        TwistPhase("diagonal", 2.5, lambda t: (diagonal, diagonal, 0.0)),
        TwistPhase("spin", 3.0, lambda t: (0.0, 0.0, pace.yaw_rate)),
        TwistPhase("circle + spin", LAP_TIME, circle),
    ]


def drive_twists(driver: DemoDriver, pace: DemoSpeeds) -> list[TwistPhase]:
    """Drive all phases, each from rest to rest."""
    driven = []
    for phase in twist_phases(pace):
        driver.progress.begin(phase.name)
        driven.append(replace(phase, start=driver.now))
        for elapsed in driver.ticks(phase.duration):
            driver.robot.drive(*phase.twist(elapsed))
            driver.progress.update(elapsed / phase.duration, driver.note)
        driver.robot.halt()
        driver.pause(PAUSE)
        driver.progress.end(driver.note)
    driver.rest()
    return driven


# ---- the path of CCTA 2017, Fig. 7, while the arm moves ------------------------------------


def to_odom(poses: Array, origin: Triple) -> Array:
    """Transform poses (k, 3) from a frame whose pose in odom is `origin` to odom [m, m, rad]."""
    result: Array = poses @ se2.rotation(origin[2]) + np.array(origin)
    return result


def poses_along(movement: Movement, origin: Triple) -> Array:
    """Return the poses (k, 3) in odom of a movement whose frame is at `origin` [m, m, rad]."""
    steps = max(2, math.ceil(movement.length / SPACING))
    return to_odom(movement.at(np.linspace(0.0, movement.length, steps + 1))[0], origin)


def time_for(length: float) -> float:
    """Return the longest time for a path of a length [m]."""
    return EXTRA_TIME + length / SLOWEST_SPEED


def drive_path(driver: DemoDriver) -> tuple[list[Interval], list[ArmMove]]:
    """Follow the path from the robot's present pose; return its movements, and the arm's moves."""
    robot, origin = driver.robot, driver.robot.pose.value
    arm_start = driver.arm_angles if driver.has_arm else None
    driven, arm_moves = [], []
    for i, movement in enumerate(movements()):
        arm, start = None, driver.now
        if arm_start is not None:
            angles = arm_start + ARM_POSES[i % len(ARM_POSES)]
            arm = robot.move_joints(angles.tolist(), ARM_MOVE_TIME)
        motion = robot.follow(poses_along(movement, origin))
        interval = driver.arrive(f"path: {movement.name}", motion, time_for(movement.length))
        driven.append(replace(interval, name=movement.name))
        if arm is not None:
            arm.wait(ARM_TIMEOUT)
            arm_moves.append(ArmMove(tuple(angles.tolist()), start, interval.end))
    return driven, arm_moves


# ---- a path of the tool, with platform and arm synchronised --------------------------------


def drive_tool(driver: DemoDriver, posts: Sequence[Post] = ()) -> tuple[DrivenTool, ArmMove]:
    """Move the arm to its start angles, and the tool along the path from there.

    Platform and arm avoid the posts and persons of a world.

    Returns:
        The path of the tool, and the arm's move before it.
    """
    driver.progress.begin("arm to start pose")
    start = driver.now
    driver.robot.move_joints(START_ANGLES, ARM_MOVE_TIME).wait(ARM_TIMEOUT)
    driver.rest()
    move = ArmMove(START_ANGLES, start, driver.now)
    driver.progress.end(driver.note)
    positions = tool_positions(driver.robot.tool.value, driver.robot.pose.value.heading)
    with driver.record_perception() as perception:
        motion = driver.robot.follow_tool(positions)
        interval = driver.arrive("tool, obstacles", motion, time_for(LENGTH))
    return DrivenTool(interval, posts, People.of(perception, interval.start)), move


def tool_positions(start: Triple, heading: float) -> Array:
    """Return the positions (k, 3) of the tool in odom along the path [m].

    Args:
        start: Position of the tool in odom [m].
        heading: Direction of the path in odom [rad].
    """
    x = np.linspace(0.0, LENGTH, math.ceil(LENGTH / SPACING) + 1)
    z = 0.5 * WAVE_HEIGHT * (1.0 - np.cos(WAVES * math.tau * x / LENGTH))
    # The rotation about the vertical leaves z as it is.
    line = np.column_stack([x, np.zeros_like(x), z])
    result: Array = line @ se2.rotation(heading) + np.array(start)
    return result


# ---- a goal among obstacles ----------------------------------------------------------------


def drive_to_goal(driver: DemoDriver, by_scanner: bool) -> DrivenGoal:
    """Drive to a goal by the planner.

    By its scanner, the robot sees the persons of a world; else it is told of obstacles that
    nobody else knows, and which cross its path.
    """
    robot, pose = driver.robot, driver.robot.pose.value
    if by_scanner:
        goal = np.array(GOAL_IN_WORLD)
        with driver.record_perception() as perception:
            interval = driver.arrive("goal, obstacles", robot.go_to(*goal), GOAL_TIMEOUT)
        people = People.of(perception, interval.start)
        return DrivenGoal(goal, people, interval, perception)
    goal = to_odom(np.array([GOAL]), pose)[0]
    obstacles = DemoObstacles.in_front_of(pose, driver.now + NOTICE_TIME)
    obstacles.show_to(robot, driver.now)
    driver.pause(NOTICE_TIME)
    interval = driver.arrive("goal, obstacles", robot.go_to(*goal), GOAL_TIMEOUT)
    obstacles.hide_from(robot)
    return DrivenGoal(goal, obstacles, interval, None)


# ---- a wheel without torque ----------------------------------------------------------------


@dataclass(frozen=True)
class DeadWheel:
    """A path on which a motor lost its torque."""

    wheel: str
    interval: Interval  #: In which the path was driven
    delay: float  #: From the loss until the controller reported it [s]


def drive_with_dead_wheel(driver: DemoDriver, wheel: str) -> DeadWheel:
    """Drive a path of two straights, switch a motor's torque off on it, and on again at its end.

    Raises:
        CommandError: The controller did not notice the loss, the robot did not arrive, or the
            wheel could not be repaired.
    """
    lost = noticed = math.inf

    def health() -> str:
        return driver.recorder.health.get(wheel, DRIVING)

    def lose_wheel() -> None:
        nonlocal lost, noticed
        if not math.isfinite(lost) and (motion.feedback.progress or 0.0) > FAULT_PROGRESS:
            lost = driver.now
            driver.disable_motors([wheel])
        elif lost < math.inf == noticed and health() not in ("", DRIVING):
            noticed = driver.now

    corners = np.array([[0.0, 0.0, 0.0], [EDGE, 0.0, 0.0], [EDGE, EDGE, 0.0]])
    motion = driver.robot.follow(to_odom(corners, driver.robot.pose.value))
    interval = driver.arrive("dead wheel", motion, time_for(2.0 * EDGE), lose_wheel)
    if not math.isfinite(noticed):
        raise CommandError(f"the controller did not notice that '{wheel}' has no torque")
    driver.disable_motors([])
    driver.reset()
    if not driver.wait(lambda: health() == DRIVING, SERVICE_TIMEOUT):
        raise CommandError(f"wheel '{wheel}' is still reported as dead after the reset")
    return DeadWheel(wheel, interval, noticed - lost)


# ---- an emergency stop while platform and arm move -----------------------------------------


def drive_and_stop(driver: DemoDriver, speed: float) -> DrivenStop:
    """Press the stop while driving forwards [m/s], go on sending twists, and reset the robot.

    Raises:
        CommandError: The robot did not stop, or cannot be reset.
    """
    driver.progress.begin("emergency stop")
    if driver.has_arm:
        angles = driver.arm_angles + ARM_SWING
        driver.robot.move_joints(angles.tolist(), ARM_SWING_TIME)
    driver.robot.drive(speed, 0.0, 0.0)
    driver.pause(DRIVING_TIME)
    pressed, driver.expects_stop = driver.now, True
    driver.press_emergency_stop(pressed=True)
    driver.pause(STOPPED_TIME)
    if not driver.robot.stop_reason.value:
        raise CommandError("the emergency stop did not stop the robot")
    driver.robot.halt()
    driver.progress.update(0.5, driver.note)
    driver.press_emergency_stop(pressed=False)
    driver.pause(PAUSE)
    driver.reset()
    driver.expects_stop, reset = False, driver.now
    driver.pause(WATCHED_TIME)
    driver.progress.end(driver.note)
    return DrivenStop(pressed, reset, driver.now)
