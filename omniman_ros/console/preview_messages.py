"""Preview messages for `path/reference`, made from a motion that is a function of time."""

from typing import Protocol

from geometry_msgs.msg import Transform, Twist, Vector3
from rclpy.duration import Duration
from rclpy.time import Time
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.conversions.trajectories import PLATFORM_JOINT
from omniman_ros.core.planar import PlanarSample, Triple

PREVIEW_PERIOD = 0.025  #: Time between two previews [s]
PREVIEW_POINTS = 13  #: Number of points of a preview, which spans 0.3 s
PREVIEW_STEP = 0.025  #: Time between two points of a preview [s]


class PlanarMotion(Protocol):
    """A motion of the platform as a function of time."""

    def sample(self, time: float) -> PlanarSample:
        """Return the reference at a time from the start [s]; at rest before and after it."""
        ...


def twist_message(twist: Triple) -> Twist:
    """Return a planar twist or velocity (x, y, angular) [m/s, m/s, rad/s] as a message."""
    x, y, yaw_rate = twist
    return Twist(linear=Vector3(x=x, y=y), angular=Vector3(z=yaw_rate))


def preview_point(sample: PlanarSample, after: Duration) -> MultiDOFJointTrajectoryPoint:
    """Return a sample as a point of a preview, a time after the stamp of its header."""
    x, y, theta = sample.pose
    pose = Transform(translation=Vector3(x=x, y=y), rotation=quaternion_from_yaw(theta))
    return MultiDOFJointTrajectoryPoint(
        transforms=[pose],
        velocities=[twist_message(sample.velocity)],
        accelerations=[twist_message(sample.acceleration)],
        time_from_start=after.to_msg(),
    )


def preview_message(motion: PlanarMotion, now: Time, start: Time) -> MultiDOFJointTrajectory:
    """Return a preview of the next 0.3 s of a motion, at rest from the end of the motion."""
    message = MultiDOFJointTrajectory(joint_names=[PLATFORM_JOINT])
    message.header.frame_id = "odom"
    message.header.stamp = now.to_msg()
    elapsed = (now - start).nanoseconds * 1e-9
    message.points = [
        preview_point(
            motion.sample(elapsed + i * PREVIEW_STEP),
            Duration(nanoseconds=round(i * PREVIEW_STEP * 1e9)),
        )
        for i in range(PREVIEW_POINTS)
    ]
    return message
