"""A robot without nodes that does what the demo asks on stepped time."""

import math
from types import SimpleNamespace

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, Transform, Vector3
from nav_msgs.msg import Odometry
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from trajectory_msgs.msg import (
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
    MultiDOFJointTrajectoryPoint,
)

from omniman_ros.client.handle import MotionHandle
from omniman_ros.client.state import NodeAnswer, NodesRefusedError, PlanarPose, Reading
from omniman_ros.console import session as console_session
from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.demo import driver as demo_driver
from omniman_ros.demo.driver import DemoDriver

STEP = 0.02  # time between two steps [s]
MOTION_TIME = 2.0  # time that each path and each goal takes [s]
NOTICE_TIME = 0.2  # time after which a dead motor is reported [s]


class SteppedRobot:
    """Node, session, robot and its client in one: time passes only while the demo waits.

    Args:
        defects: What the robot does not do, of "publish", "progress", "plan", "move_arm",
            "notice", "repair", "stop", "reset".
    """

    def __init__(self, *defects):
        self.node = self
        self.time = 1000.0  # ROS time [s]
        self.asked = []  # kinds of the motions, and "obstacle" for each that it is told of
        self.stopped = False  # whether the platform's controller is stopped
        self.defects = defects
        self.ended = []  # topics whose subscriptions were ended
        self.callbacks = {}  # by topic
        self._pose = np.zeros(3)
        self._twist = np.zeros(3)
        self._arm = np.zeros(6)
        self._motion = None
        self._dead = []
        self._dead_since = math.inf

    # ---- session and node ---------------------------------------------------------------------

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

    def create_subscription(self, message_type, topic, callback, qos):
        self.callbacks[topic] = callback
        return topic

    def destroy_subscription(self, subscription):
        self.ended.append(subscription)

    def create_publisher(self, message_type, topic, qos):
        assert topic == "emergency_stop"
        return SimpleNamespace(publish=self._on_emergency_stop)

    def _on_emergency_stop(self, message):
        if message.data and "stop" not in self.defects:
            self.stopped = True

    def create_client(self, service_type, name):
        def call_async(request):
            self._dead = list(request.parameters[0].value.string_array_value)
            self._dead_since = self.time if self._dead else self._dead_since
            return SimpleNamespace(done=lambda: True)

        return SimpleNamespace(srv_name=name, call_async=call_async)

    # ---- client -------------------------------------------------------------------------------

    @property
    def pose(self):
        return Reading("odom", 0.0, PlanarPose(*self._pose.tolist()))

    @property
    def joints(self):
        return Reading("joints", 0.0, dict(zip(UR_JOINTS, self._arm.tolist(), strict=True)))

    @property
    def tool(self):
        return Reading("tool", 0.0, (0.5, 0.0, 1.0))

    @property
    def active_source(self):
        return Reading("active_source", 0.0, "path" if self._motion else "none")

    is_open = True

    @property
    def stop_reason(self):
        return Reading("stop", 0.0, "platform_controller stopped: x" if self.stopped else "")

    def wait_until_ready(self, timeout, needs):
        self.needs = needs

    def drive(self, *twist):
        self._twist = np.array(twist)

    def halt(self):
        self._twist = np.zeros(3)

    def follow(self, poses):
        return self._begin("path", poses)

    def follow_tool(self, positions):
        return self._begin("tool", [self._pose, self._pose])

    def go_to(self, *goal):
        return self._begin("goal", [self._pose, goal], "plan" not in self.defects)

    def move_joints(self, angles, duration):
        handle = self._begin("arm", None, "move_arm" not in self.defects)
        if handle.outcome is None:
            self._arm = np.array(angles)
            handle.report("/robot", "arrived", "")
        return handle

    def _begin(self, kind, poses, accepted=True):
        self.asked.append(kind)
        handle = MotionHandle(kind, f"motion of the {kind}", self)
        handle.report("/robot", "started" if accepted else "refused", "no way")
        if accepted and poses is not None:
            self._motion = (self.time, np.array(poses), handle)
        return handle

    def reset(self):
        if "reset" in self.defects:
            raise NodesRefusedError("reset", (NodeAnswer("/robot", False, "not at rest"),))
        self.stopped = False
        if "repair" not in self.defects:
            self._dead_since = math.inf

    def add_obstacle(self, name, *place):
        self.asked.append("obstacle")

    def remove_obstacle(self, name):
        assert "obstacle" in self.asked

    # ---- time ---------------------------------------------------------------------------------

    def _step(self, seconds):
        self.time += seconds
        if self.stopped:
            self._twist = np.zeros(3)
        c, s = math.cos(self._pose[2]), math.sin(self._pose[2])
        x, y, turn = self._twist
        self._pose = self._pose + seconds * np.array([c * x - s * y, s * x + c * y, turn])
        if self._motion:
            self._follow()
        if "publish" not in self.defects:
            self._publish()

    def _follow(self):
        start, poses, handle = self._motion
        progress = 0.0 if "progress" in self.defects else (self.time - start) / MOTION_TIME
        at = np.linspace(0.0, 1.0, len(poses))
        self._pose = np.array([np.interp(progress, at, column) for column in poses.T])
        handle.advance(progress)
        if progress >= 1.0:
            self._motion = None
            handle.report("/robot", "arrived", "")

    def _publish(self):
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
            "wheel_health": status(rear_right="no torque" if is_noticed else "driving"),
        }
        for topic, message in messages.items():
            self.callbacks[topic](message)

    def _stamped(self, message_type, **values):
        message = message_type(**values)
        message.header.stamp = self.get_clock().now().to_msg()
        return message


def status(**values):
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(values=pairs)


def stepped_driver(monkeypatch, robot, poll=lambda: None, has_arm=True):
    """Return a driver whose time is the robot's."""
    progress = SimpleNamespace(
        begin=lambda name: None, update=lambda fraction, note: None, end=lambda note: None
    )
    clock = SimpleNamespace(monotonic=robot.now)
    for module in (console_session, demo_driver):
        monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr(demo_driver, "Robot", lambda node, serve: node)
    return DemoDriver(robot, progress, poll, has_arm=has_arm)
