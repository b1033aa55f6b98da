"""The legs of the demo: each drives the robot from its present pose until it is at rest.

Each raises a `CommandError` if the robot does not do what is asked, or stops.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.time import Time

from omniman_ros.console.errors import CommandError
from omniman_ros.control.limits import TwistLimits
from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.demo.driver import PAUSE, SERVICE_TIMEOUT, DemoDriver
from omniman_ros.demo.figures import ArmMove, DrivenGoal, DrivenStop, TwistPhase
from omniman_ros.demo.measures import Interval
from omniman_ros.demo.moving_obstacles import DemoObstacles
from omniman_ros.demo.perception import People
from omniman_ros.demo.robot_interface import FRAME, dead_motors_request
from omniman_ros.motion.figure7 import Movement, movements
from omniman_ros.motion.whole_body.model import WholeBodyModel

MAX_SPEED = 0.3  #: Largest linear speed of the twists [m/s]
MAX_YAW_RATE = 0.8  #: Largest yaw rate of the twists [rad/s]
LAP_TIME = 5.0  #: Time for the circle [s]

SPACING = 0.02  #: Largest horizontal distance between two poses of a path [m]
ARM_POSES = (
    (0.6, -0.5, 0.9, -0.4, 0.4, 0.8),
    (-0.5, -0.2, 0.4, -0.8, -0.6, -0.7),
    (0.3, -0.7, 0.2, 0.5, 0.7, 0.4),
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
)  #: Joint angles to which the arm moves in each movement, relative to those at the start [rad]

#: Joint angles for the tool's path: arm bent, tool pointing down in front of the robot [rad]
START_ANGLES = np.array([0.0, -1.9, 2.0, -1.7, -1.57, 0.0])
START_TIMEOUT = 10.0  #: Time within which the arm must reach these angles [s]
START_TOLERANCE = 0.005  #: Deviation within which the arm has reached these angles [rad]
STRAIGHT = 1.2  #: Length of the straight at the start of the tool's path [m]
RADIUS = 0.7  #: Radius of the left bend after the straight [m]
BEND = math.pi  #: Angle of the left bend [rad]
WAVE_HEIGHT = 0.06  #: Height between the highest and the lowest point of the tool's path [m]
WAVES = 2.0  #: Number of waves of its height

#: Pose of the goal, beyond the obstacles, in the robot's frame at the start [m, m, rad]
GOAL = (3.2, 0.3, 1.5707963)
GOAL_TIMEOUT = 30.0  #: Time within which the goal must be reached [s]
OBSERVATION_PERIOD = 0.05  #: Period of the observations of the obstacles [s]

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
            driver.robot.send_twist(phase.twist(elapsed))
            driver.progress.update(elapsed / phase.duration, driver.note)
        for _ in driver.ticks(PAUSE):
            driver.halt()
        driver.progress.end(driver.note)
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


def drive_path(driver: DemoDriver) -> tuple[list[Interval], list[ArmMove]]:
    """Follow the path from the robot's present pose; return its movements, and the arm's moves.

    Raises:
        CommandError: Another source drives the platform, or a movement failed.
    """
    if not driver.wait_until_idle():
        source = driver.recorder.active_source
        raise CommandError(f"'{source}' still drives the platform, expected none")
    origin = driver.pose
    arm_start = driver.arm_angles if driver.has_arm else None
    driven, arm_moves = [], []
    for i, movement in enumerate(movements()):
        if arm_start is not None:
            arm_moves.append(driver.move_arm(arm_start + ARM_POSES[i % len(ARM_POSES)]))
        send = partial(driver.robot.send_path, poses_along(movement, origin))
        interval = driver.follow(f"path: {movement.name}", send, movement.length)
        driven.append(replace(interval, name=movement.name))
        if arm_moves:
            arm_moves[-1] = replace(arm_moves[-1], end=interval.end)
    return driven, arm_moves


# ---- a path of the tool, with platform and arm synchronised --------------------------------


def drive_tool(driver: DemoDriver, model: WholeBodyModel) -> tuple[Interval, ArmMove]:
    """Move the arm to its start angles, and the tool along the path from there.

    The result is the interval in which the tool was moved, and the arm's move before it.

    Raises:
        CommandError: The arm did not reach the start, or the path was not completed.
    """
    driver.progress.begin("arm to start pose")
    move = driver.move_arm(START_ANGLES)
    if not driver.wait(
        lambda: float(np.abs(driver.arm_angles - START_ANGLES).max()) < START_TOLERANCE,
        START_TIMEOUT,
    ):
        raise CommandError("the arm did not reach the start of the tool's path")
    driver.rest()
    move = replace(move, end=driver.now)
    driver.progress.end(driver.note)
    start = model.forward(np.array([*driver.pose, *driver.arm_angles]))
    poses = tool_poses(start, driver.pose[2])
    length = float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum())
    path = tool_path_message(poses, FRAME)
    return driver.follow("tool path", lambda: driver.robot.send_tool_path(path), length), move


def tool_poses(start: Array, heading: float) -> Array:
    """Return the poses (k, 4, 4) of the tool in odom along the path.

    Args:
        start: Pose (4, 4) of the tool in odom. The tool keeps its orientation.
        heading: Direction of the straight in odom [rad].
    """
    length = STRAIGHT + RADIUS * BEND
    s = np.linspace(0.0, length, math.ceil(length / SPACING) + 1)
    angle = np.maximum(s - STRAIGHT, 0.0) / RADIUS
    x = np.minimum(s, STRAIGHT) + RADIUS * np.sin(angle)
    y = RADIUS * (1.0 - np.cos(angle))
    z = 0.5 * WAVE_HEIGHT * (1.0 - np.cos(WAVES * math.tau * s / length))
    poses = np.repeat(start[None], len(s), axis=0)
    poses[:, :2, 3] += np.column_stack([x, y]) @ se2.rotation(heading)[:2, :2]
    poses[:, 2, 3] += z
    return poses


def tool_path_message(poses: Array, frame: str) -> Path:
    """Return poses (k, 4, 4) as a path in a frame."""
    path = Path()
    path.header.frame_id = frame
    for pose in poses:
        stamped = PoseStamped()
        arm_conversions.fill_pose(stamped.pose, pose)
        path.poses.append(stamped)
    return path


# ---- a goal among obstacles ----------------------------------------------------------------


def drive_to_goal(driver: DemoDriver, by_scanner: bool) -> DrivenGoal:
    """Drive to a goal by the planner.

    By its scanner, the robot sees the persons of a world; else it is told of obstacles that
    nobody else knows, and which cross its path.

    Raises:
        CommandError: The goal was not reached in time.
    """
    driver.progress.begin("goal, obstacles")
    driver.wait_until_idle()
    start = driver.now
    goal = to_odom(np.array([GOAL]), driver.pose)[0]
    obstacles: DemoObstacles | People
    if by_scanner:
        with driver.record_perception() as perception:
            _drive_to(driver, goal, lambda: None)
        obstacles = People(perception.people or [(start, np.zeros((0, 3)))])
    else:
        perception = None
        obstacles = DemoObstacles.in_front_of(driver.pose, start)
        observe = partial(_observe, driver, obstacles)
        observe()
        _drive_to(driver, goal, observe)
        driver.robot.send_obstacles(obstacles.removal_message())
    driven = DrivenGoal(goal, obstacles, Interval("goal", start, driver.now), perception)
    driver.rest()
    driver.progress.end(driver.note)
    return driven


def _observe(driver: DemoDriver, obstacles: DemoObstacles) -> None:
    now = driver.now
    stamp = Time(nanoseconds=round(1e9 * now)).to_msg()
    driver.robot.send_obstacles(obstacles.message(now, stamp))


def _drive_to(driver: DemoDriver, goal: Array, observe: Callable[[], None]) -> None:
    """Send the goal, then observations until the planner has driven and arrived."""
    driver.robot.send_goal(goal)
    driver.recorder.planner.clear()
    distance, has_driven, remaining = math.hypot(*GOAL[:2]), False, math.inf
    for _ in driver.ticks(GOAL_TIMEOUT, OBSERVATION_PERIOD):
        observe()
        x, y, _ = driver.pose
        remaining = math.hypot(goal[0] - x, goal[1] - y)
        driver.progress.update(1.0 - remaining / distance, driver.note)
        state = driver.recorder.planner.get("state")
        has_driven = has_driven or state == "driving"
        if has_driven and state == "arrived":
            return
    reported = driver.recorder.planner.get("last", "nothing")
    raise CommandError(
        f"the goal was not reached, {remaining:.2f} m remain; mpc_planner reports: "
        f"{reported}{driver.recorder.recording.stall_note}"
    )


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
        if not math.isfinite(lost) and driver.recorder.progress > FAULT_PROGRESS:
            lost = driver.now
            driver.call(driver.robot.faults, dead_motors_request([wheel]))
        elif lost < math.inf == noticed and health() not in ("", DRIVING):
            noticed = driver.now

    corners = np.array([[0.0, 0.0, 0.0], [EDGE, 0.0, 0.0], [EDGE, EDGE, 0.0]])
    send = partial(driver.robot.send_path, to_odom(corners, driver.pose))
    interval = driver.follow("dead wheel", send, 2.0 * EDGE, lose_wheel)
    if not math.isfinite(noticed):
        raise CommandError(f"the controller did not notice that '{wheel}' has no torque")
    driver.call(driver.robot.faults, dead_motors_request([]))
    for client in driver.robot.resets:
        driver.reset(client)
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
    driver.wait_until_idle()
    forwards: Triple = (speed, 0.0, 0.0)
    if driver.has_arm:
        driver.robot.send_arm_goal(driver.arm_angles + ARM_SWING, ARM_SWING_TIME)
    for _ in driver.ticks(DRIVING_TIME):
        driver.robot.send_twist(forwards)
    pressed, driver.expects_stop = driver.now, True
    driver.robot.send_emergency_stop(pressed=True)
    for _ in driver.ticks(STOPPED_TIME):
        driver.robot.send_twist(forwards)
    if not driver.recorder.stopped:
        raise CommandError("the emergency stop did not stop the robot")
    driver.progress.update(0.5, driver.note)
    driver.robot.send_emergency_stop(pressed=False)
    driver.pause(PAUSE)
    driver.reset_all()
    driver.expects_stop, reset = False, driver.now
    driver.pause(WATCHED_TIME)
    driver.progress.end(driver.note)
    return DrivenStop(pressed, reset, driver.now)
