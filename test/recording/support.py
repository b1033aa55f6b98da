"""Messages and recordings that are made without a robot."""

import numpy as np
from rosbags.typesys import Stores, get_typestore

from omniman_ros.recording.definitions import MessageDefinitions
from omniman_ros.recording.topic_metadata import TopicMetadata
from omniman_ros.recording.writer import BagWriter

STORE = get_typestore(Stores.ROS2_JAZZY)
T = STORE.types


def time(seconds):
    whole = int(seconds)
    return T["builtin_interfaces/msg/Time"](whole, round((seconds - whole) * 1e9))


def duration(seconds):
    whole = int(seconds)
    return T["builtin_interfaces/msg/Duration"](whole, round((seconds - whole) * 1e9))


def header(stamp):
    return T["std_msgs/msg/Header"](time(stamp), "odom")


def vector(x, y, z=0.0):
    return T["geometry_msgs/msg/Vector3"](x, y, z)


def turn(theta):
    return T["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(theta / 2), np.cos(theta / 2))


def pose(x, y, theta):
    return T["geometry_msgs/msg/Pose"](T["geometry_msgs/msg/Point"](x, y, 0.0), turn(theta))


def twist(x, y, angle):
    return T["geometry_msgs/msg/Twist"](vector(x, y), vector(0.0, 0.0, angle))


def odometry(stamp, position, velocity=(0.0, 0.0, 0.0)):
    no_covariance = np.zeros(36)
    return T["nav_msgs/msg/Odometry"](
        header(stamp),
        "base_link",
        T["geometry_msgs/msg/PoseWithCovariance"](pose(*position), no_covariance),
        T["geometry_msgs/msg/TwistWithCovariance"](twist(*velocity), no_covariance),
    )


def joints(stamp, names, position=(), velocity=(), effort=()):
    arrays = [np.array(values, dtype=float) for values in (position, velocity, effort)]
    return T["sensor_msgs/msg/JointState"](header(stamp), list(names), *arrays)


def preview(stamp, points):
    """A reference; `points` are pairs of the time from the start and the pose."""
    point = T["trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"]
    return T["trajectory_msgs/msg/MultiDOFJointTrajectory"](
        header(stamp),
        ["platform"],
        [
            point(
                [T["geometry_msgs/msg/Transform"](vector(x, y), turn(theta))],
                [],
                [],
                duration(after),
            )
            for after, (x, y, theta) in points
        ],
    )


def status(**values):
    pairs = [T["diagnostic_msgs/msg/KeyValue"](key, str(v)) for key, v in values.items()]
    return T["diagnostic_msgs/msg/DiagnosticStatus"](0, "/mpc_planner", "", "", pairs)


def numbers(*sizes, data):
    dims = [T["std_msgs/msg/MultiArrayDimension"]("d", size, size) for size in sizes]
    layout = T["std_msgs/msg/MultiArrayLayout"](dims, 0)
    return T["std_msgs/msg/Float64MultiArray"](layout, np.array(data, dtype=float))


def text(data):
    return T["std_msgs/msg/String"](data)


def write(folder, messages):
    """Write a recording of (arrival [s], topic, message); return its folder."""
    definitions = MessageDefinitions()
    with BagWriter(folder) as writer:
        added = set()
        for arrival, topic, message in sorted(messages, key=lambda row: row[0]):
            message_type = message.__msgtype__
            if topic not in added:
                added.add(topic)
                writer.add_topic(
                    TopicMetadata(topic, message_type, *definitions.lookup(message_type))
                )
            assert writer.put(
                topic, round(arrival * 1e9), bytes(STORE.serialize_cdr(message, message_type))
            )
    assert not writer.failure
    return folder
