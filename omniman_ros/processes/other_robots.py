"""Refusal to start a robot where another one already uses the same topics."""

from collections.abc import Callable

from rclpy.node import Node

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import ANNOUNCEMENT_TIME, Session


def refuse_other_robots(check: Callable[[], None]) -> None:
    """Check that there is no robot in this ROS domain before nodes are started in it.

    Raises:
        CommandError: There is a robot: commands meant for the new one would drive it as well,
            and both drives would publish on the same topics.
    """

    def robot_found() -> bool:
        check()
        return is_robot_present(session.node)

    with Session("omniman_demo") as session:
        if session.wait(robot_found, ANNOUNCEMENT_TIME):
            raise CommandError(
                "another robot is in this ROS domain (a node that was killed is seen for 20 s): "
                "end it, or choose another ROS_DOMAIN_ID"
            )


def is_robot_present(node: Node) -> bool:
    """Return whether any node publishes wheel commands or subscribes to cmd_vel."""
    return bool(node.count_publishers("wheel_commands") or node.count_subscribers("cmd_vel"))
