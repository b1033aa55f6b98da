"""Commands and services through which the demo moves the robot."""

from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Path
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import MarkerArray

from omniman_ros.console.preview_messages import twist_message
from omniman_ros.conversions.poses import path_message
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.demo.recorder import LATCHED
from omniman_ros.processes.robot_setup import WORLD_DRIVE

FRAME = "odom"  #: Frame in which the demo sends its paths and goals
FAULTY_NODE = {
    "simulated": "simulated_drive",
    "can": "simulated_can_drives",
    WORLD_DRIVE: "simulated_world",
}  #: Node that simulates faults of the motors, by kind of drive
#: Node that executes the wheel commands, by kind of drive
WHEEL_DRIVER = FAULTY_NODE | {"can": "can_bridge"}


class RobotInterface:
    """Publishers and service clients of the topics and services that command the robot.

    Args:
        drive: Kind of drive, a key of `FAULTY_NODE`.
    """

    def __init__(self, node: Node, drive: str) -> None:
        self._twists = node.create_publisher(Twist, "cmd_vel", 1)
        self._paths = node.create_publisher(Path, "path", 10)
        self._arm_goals = node.create_publisher(JointTrajectory, "joint_trajectory", 10)
        self._tool_paths = node.create_publisher(Path, "tool_path", 10)
        self._goals = node.create_publisher(PoseStamped, "goal_pose", 10)
        self._obstacles = node.create_publisher(MarkerArray, "obstacles", 50)
        self._emergency_stop = node.create_publisher(Bool, "emergency_stop", LATCHED)
        self.faults = node.create_client(SetParameters, f"{FAULTY_NODE[drive]}/set_parameters")
        #: Resets of the wheel driver and of the platform's controller
        self.resets = [
            node.create_client(Trigger, f"{name}/reset")
            for name in (WHEEL_DRIVER[drive], "platform_controller")
        ]

    @property
    def unconnected_topics(self) -> list[str]:
        """Topics of platform and planner that have no subscriber yet."""
        needed = (self._twists, self._paths, self._tool_paths, self._goals, self._obstacles)
        return [p.topic_name for p in needed if not p.get_subscription_count()]

    def send_twist(self, twist: Triple) -> None:
        """Send a body twist x', y' [m/s], theta' [rad/s]."""
        self._twists.publish(twist_message(twist))

    def send_path(self, poses: Array) -> None:
        """Send a path of the platform: poses (k, 3) in odom [m, m, rad]."""
        self._paths.publish(path_message(poses, FRAME))

    def send_tool_path(self, path: Path) -> None:
        """Send a path of the tool."""
        self._tool_paths.publish(path)

    def send_goal(self, goal: Array) -> None:
        """Send a goal (3,) to the planner: x, y, theta in odom [m, m, rad]."""
        message = path_message(goal[None], FRAME).poses[0]
        message.header.frame_id = FRAME
        self._goals.publish(message)

    def send_obstacles(self, obstacles: MarkerArray) -> None:
        """Send an observation of the obstacles."""
        self._obstacles.publish(obstacles)

    def send_arm_goal(self, angles: Array, duration: float = 0.0) -> None:
        """Send joint angles (6,) [rad] that the arm moves to, in the order of `UR_JOINTS`.

        A duration of 0 s lets the arm move as fast as its limits allow.
        """
        point = JointTrajectoryPoint(positions=angles.tolist())
        if duration:
            point.time_from_start = Duration(seconds=duration).to_msg()
        self._arm_goals.publish(JointTrajectory(joint_names=list(UR_JOINTS), points=[point]))

    def send_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop."""
        self._emergency_stop.publish(Bool(data=pressed))


def dead_motors_request(wheels: list[str]) -> SetParameters.Request:
    """Return the request that switches the torque of some motors off, and of all others on."""
    value = ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=wheels)
    return SetParameters.Request(
        parameters=[ParameterMessage(name="faults.dead_motor", value=value)]
    )
