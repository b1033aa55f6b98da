"""A command's own ROS node."""

from nav_msgs.msg import Odometry

from omniman_ros.console.session import Session
from omniman_ros.processes.ros_domain import is_free


def test_a_closed_session_has_left_its_domain(own_domain):
    with Session("probe") as session:
        received = []
        session.node.create_subscription(Odometry, "odom", received.append, 10)
        publisher = session.node.create_publisher(Odometry, "odom", 10)
        timer = session.node.create_timer(0.01, lambda: publisher.publish(Odometry()))
        assert session.wait(lambda: bool(received), 10.0)
        assert not is_free(own_domain)
    # References to its entities do not keep the participant in the domain.
    assert timer is not None and is_free(own_domain)
