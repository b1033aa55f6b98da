"""Previews on `path/reference`, made from a motion that is known as a function of time."""

from typing import Protocol

from geometry_msgs.msg import Transform, Twist, Vector3
from rclpy.duration import Duration
from rclpy.time import Time
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from omniman_ros.cli.figures import Sample, Triple
from omniman_ros.conversions import PLATFORM_JOINT, quaternion

PREVIEW_PERIOD = 0.025
PREVIEW_POINTS = 13
PREVIEW_STEP = 0.025
"""A preview of 0.3 s every 25 ms, a point every 25 ms."""


class Motion(Protocol):
    """A motion in time."""

    def sample(self, time: float) -> Sample:
        """The reference so many seconds after its start; at rest before it and after its end."""
        ...


def twist_message(twist: Triple) -> Twist:
    """A body twist or a world velocity as a message."""
    x, y, angle = twist
    return Twist(linear=Vector3(x=x, y=y), angular=Vector3(z=angle))


def preview_point(sample: Sample, after: Duration) -> MultiDOFJointTrajectoryPoint:
    """A sample as a point, due some time after the header's stamp."""
    x, y, theta = sample.pose
    pose = Transform(translation=Vector3(x=x, y=y), rotation=quaternion(theta))
    return MultiDOFJointTrajectoryPoint(
        transforms=[pose],
        velocities=[twist_message(sample.velocity)],
        accelerations=[twist_message(sample.acceleration)],
        time_from_start=after.to_msg(),
    )


def preview_message(motion: Motion, now: Time, start: Time) -> MultiDOFJointTrajectory:
    """The next 0.3 s of a motion that starts at `start`; it ends at rest where the motion does."""
    message = MultiDOFJointTrajectory(joint_names=[PLATFORM_JOINT])
    message.header.frame_id = "odom"
    message.header.stamp = now.to_msg()
    since = (now - start).nanoseconds * 1e-9
    message.points = [
        preview_point(
            motion.sample(since + i * PREVIEW_STEP),
            Duration(nanoseconds=round(i * PREVIEW_STEP * 1e9)),
        )
        for i in range(PREVIEW_POINTS)
    ]
    return message
