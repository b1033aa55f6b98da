"""Recordings as tables: of a robot with ROS, or of a simulation without."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.typesys import Stores, get_typestore

from omniman_ros.core.errors import InputError
from omniman_ros.recording.reader import BagReader
from omniman_ros.recording.robot_log import RobotLog, read_robot_log
from omniman_ros.recording.writer import METADATA_VERSION

_STORE = get_typestore(Stores.ROS2_JAZZY)
_TYPES = _STORE.types


def read_recording(
    path: str | Path, wheel_names: tuple[str, ...] = (), namespace: str = ""
) -> RobotLog:
    """Return the tables of one robot in a rosbag2 recording, MCAP or SQLite.

    Args:
        path: Folder of the recording, or its only file.
        wheel_names: Names of the wheels in the order that the tables shall have; by default those
            of the first message.
        namespace: Namespace of the robot's topics.

    Raises:
        InputError: There is no recording at the path, or it is damaged, or it contains no data of
            a robot of that namespace.
    """
    with BagReader(Path(path)) as bag:
        log = read_robot_log(bag, namespace, wheel_names)
    _ = log.span
    return log


def write_recording(folder: str | Path, log: RobotLog) -> str:
    """Write `odom`, `truth` and the wheels' measurements as a recording (MCAP); return its path.

    The topics are `/odom`, `/ground_truth/odom` and `/wheel_states`; a message arrives when it is
    stamped.

    Raises:
        InputError: The folder exists or cannot be written, or the wheels' tables do not fit.
    """
    if log.angles.shape != log.measured.shape or log.measured.shape[1] != 1 + len(log.wheel_names):
        raise InputError(
            f"angles {log.angles.shape}, speeds {log.measured.shape} and "
            f"{len(log.wheel_names)} names of wheels do not fit each other"
        )
    topics = (
        ("/odom", log.odom, _odometry),
        ("/ground_truth/odom", log.truth, _odometry),
        ("/wheel_states", np.hstack([log.angles, log.measured[:, 1:]]), _wheels(log.wheel_names)),
    )
    try:
        with Writer(
            Path(folder), version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP
        ) as writer:
            for topic, table, message_of in topics:
                messages = [message_of(*row) for row in table.tolist()]
                if messages:
                    kind = messages[0].__msgtype__
                    connection = writer.add_connection(topic, kind, typestore=_STORE)
                for time, message in zip(table[:, 0].tolist(), messages, strict=True):
                    writer.write(
                        connection, round(time * 1e9), _STORE.serialize_cdr(message, kind)
                    )
    except (WriterError, OSError) as error:
        raise InputError(f"cannot write {folder}: {error}") from error
    return str(folder)


def _header(time: float, frame: str = "") -> Any:
    seconds, nanoseconds = divmod(round(time * 1e9), 1_000_000_000)
    stamp = _TYPES["builtin_interfaces/msg/Time"](seconds, nanoseconds)
    return _TYPES["std_msgs/msg/Header"](stamp, frame)


def _odometry(time: float, *values: float) -> Any:
    """Return an Odometry of x, y, theta and twist, without covariances."""
    x, y, theta, vx, vy, yaw_rate = values
    vector = _TYPES["geometry_msgs/msg/Vector3"]
    pose = _TYPES["geometry_msgs/msg/Pose"](
        _TYPES["geometry_msgs/msg/Point"](x, y, 0.0),
        _TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2)),
    )
    twist = _TYPES["geometry_msgs/msg/Twist"](vector(vx, vy, 0.0), vector(0.0, 0.0, yaw_rate))
    return _TYPES["nav_msgs/msg/Odometry"](
        _header(time, "odom"),
        "base_link",
        _TYPES["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
        _TYPES["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
    )


def _wheels(names: Sequence[str]) -> Callable[..., Any]:
    def joint_state(time: float, *values: float) -> Any:
        position, velocity = np.array(values).reshape(2, -1)
        return _TYPES["sensor_msgs/msg/JointState"](
            _header(time), list(names), position, velocity, np.zeros(0)
        )

    return joint_state
