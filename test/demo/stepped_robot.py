"""A robot without nodes that follows the demo's commands on stepped time."""

import math
from types import SimpleNamespace

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, Transform, Vector3
from nav_msgs.msg import Odometry
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension, String
from trajectory_msgs.msg import (
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
    MultiDOFJointTrajectoryPoint,
)

from omniman_ros.console import session as console_session
from omniman_ros.conversions.geometry import quaternion_from_yaw, yaw_from_quaternion
from omniman_ros.demo import driver as demo_driver
from omniman_ros.demo.driver import DemoDriver

STEP = 0.02  # time between two steps [s]
MOTION_TIME = 2.0  # time that each path and each goal takes [s]
NOTICE_TIME = 0.2  # time after which a dead motor is reported [s]


class SteppedRobot:
    """Node, session and robot in one: time passes only while the demo waits.

    Args:
        defects: What the robot does not do, of "publish", "progress", "plan", "move_arm",
            "notice", "repair", "stop", "reset".
    """

    def __init__(self, *defects):
        self.node = self
        self.time = 1000.0  # ROS time [s]
        self.received = {}  # messages by topic
        self.stopped = False  # whether the platform's controller is stopped
        self.defects = defects
        self.ended = []  # topics whose subscriptions were ended
        self.callbacks = {}  # by topic
        self._pose = np.zeros(3)
        self._twist = np.zeros(3)
        self._arm = np.zeros(6)
        self._motion = None
        self._planner = "idle"
        self._dead = []
        self._dead_since = math.inf

    def now(self):
        return self.time

    def spin(self, seconds):
        end = self.time + seconds
        while self.time < end - 1e-9:
            self._step(min(STEP, end - self.time))

    def wait(self, condition, timeout):
        end = self.time + timeout
        while not condition():
            if self.time >= end:
                return False
            self._step(STEP)
        return True

    def get_clock(self):
        return SimpleNamespace(now=lambda: Time(nanoseconds=round(1e9 * self.time)))

    def get_namespace(self):
        return "/"

    def create_subscription(self, message_type, topic, callback, qos):
        self.callbacks[topic] = callback
        return topic

    def destroy_subscription(self, subscription):
        self.ended.append(subscription)

    def create_publisher(self, message_type, topic, qos):
        def publish(message):
            self.received.setdefault(topic, []).append(message)
            getattr(self, f"_on_{topic}", lambda _: None)(message)

        return SimpleNamespace(topic_name=topic, publish=publish, get_subscription_count=lambda: 1)

    def create_client(self, service_type, name):
        def call_async(request):
            if name.endswith("/set_parameters"):
                self._dead = list(request.parameters[0].value.string_array_value)
                self._dead_since = self.time if self._dead else self._dead_since
            elif "repair" not in self.defects:
                self._dead_since = math.inf
            answer = SimpleNamespace(success=True)
            return SimpleNamespace(done=lambda: True, result=lambda: answer)

        return SimpleNamespace(srv_name=name, call_async=call_async)

    def _on_cmd_vel(self, message):
        self._twist = np.array([message.linear.x, message.linear.y, message.angular.z])

    def _on_path(self, message):
        poses = [(p.pose.position, p.pose.orientation) for p in message.poses]
        rows = np.array([(p.x, p.y, yaw_from_quaternion(q)) for p, q in poses])
        rows[:, 2] = np.unwrap(rows[:, 2])
        self._motion = (self.time, rows)

    def _on_tool_path(self, message):
        self._motion = (self.time, np.array([self._pose, self._pose]))

    def _on_goal_pose(self, message):
        position, orientation = message.pose.position, message.pose.orientation
        goal = np.array([position.x, position.y, yaw_from_quaternion(orientation)])
        if "plan" not in self.defects:
            self._planner = "driving"
            self._motion = (self.time, np.array([self._pose, goal]))

    def _on_joint_trajectory(self, message):
        if "move_arm" not in self.defects:
            self._arm = np.array(message.points[0].positions)

    def _on_emergency_stop(self, message):
        if message.data and "stop" not in self.defects:
            self.stopped = True

    def _step(self, seconds):
        self.time += seconds
        if self.stopped:
            self._twist = np.zeros(3)
        c, s = math.cos(self._pose[2]), math.sin(self._pose[2])
        x, y, turn = self._twist
        self._pose = self._pose + seconds * np.array([c * x - s * y, s * x + c * y, turn])
        progress = self._follow() if self._motion else None
        if "publish" not in self.defects:
            self._publish(progress)

    def _follow(self):
        start, poses = self._motion
        progress = 0.0 if "progress" in self.defects else (self.time - start) / MOTION_TIME
        at = np.linspace(0.0, 1.0, len(poses))
        self._pose = np.array([np.interp(progress, at, column) for column in poses.T])
        if progress >= 1.0:
            self._motion = None
            self._planner = "arrived" if self._planner == "driving" else self._planner
        return min(progress, 1.0)

    def _publish(self, progress):
        odom = self._stamped(Odometry)
        odom.pose.pose.position.x, odom.pose.pose.position.y = self._pose[:2].tolist()
        odom.pose.pose.orientation = quaternion_from_yaw(float(self._pose[2]))
        twist = odom.twist.twist
        twist.linear.x, twist.linear.y, twist.angular.z = self._twist.tolist()
        angles = self._arm.tolist()
        x, y, theta = self._pose.tolist()
        pose = Transform(translation=Vector3(x=x, y=y), rotation=quaternion_from_yaw(theta))
        due = MultiDOFJointTrajectoryPoint(transforms=[pose])
        timing = Float64MultiArray(data=[STEP])
        timing.layout.dim = [MultiArrayDimension(size=1)]
        is_noticed = self.time - self._dead_since > NOTICE_TIME and "notice" not in self.defects
        level = DiagnosticStatus.ERROR if self.stopped else DiagnosticStatus.OK
        messages = {
            "odom": odom,
            "ground_truth/odom": odom,
            "wheel_commands": self._stamped(JointState),
            "coupling_error": self._stamped(JointState, position=[0.0]),
            "wheel_electrical": Float64MultiArray(data=[24.0, 1.0, self.time] * 4),
            "arm/joint_states": self._stamped(JointState, position=angles),
            "arm/joint_reference": self._stamped(
                JointTrajectory, points=[JointTrajectoryPoint(positions=angles)]
            ),
            "path/reference": self._stamped(MultiDOFJointTrajectory, points=[due]),
            "tool_reference": self._stamped(PoseStamped),
            "arm/timing": timing,
            "active_source": String(data="path" if self._motion else "none"),
            "mpc/status": status(state=self._planner, last="no way"),
            "wheel_health": status(rear_right="no torque" if is_noticed else "driving"),
            "stop_state": DiagnosticStatus(
                level=level, name="/platform_controller", message="stopped: x"
            ),
        }
        if progress is not None:
            messages["path_progress"] = Float64(data=progress)
        for topic, message in messages.items():
            self.callbacks[topic](message)

    def _stamped(self, message_type, **values):
        message = message_type(**values)
        message.header.stamp = self.get_clock().now().to_msg()
        return message


def status(**values):
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(values=pairs)


class SteppedReset:
    """Reset of a stepped robot, in place of the services."""

    def __init__(self, node, action, namespace):
        assert action == "reset"
        self._robot = node
        self.answers = {}

    def poll(self):
        if "reset" not in self._robot.defects:
            self._robot.stopped = False
        else:
            self.answers["/platform_controller"] = (False, "not at rest")
        return True

    def close(self):
        pass


def stepped_driver(monkeypatch, robot, poll=lambda: None, has_arm=True):
    """Return a driver whose time is the robot's."""
    progress = SimpleNamespace(
        begin=lambda name: None, update=lambda fraction, note: None, end=lambda note: None
    )
    clock = SimpleNamespace(monotonic=robot.now)
    for module in (console_session, demo_driver):
        monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr(demo_driver, "TriggerCalls", SteppedReset)
    return DemoDriver(robot, progress, poll, has_arm=has_arm)
