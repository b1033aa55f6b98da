"""Two robots in namespaces, in one ROS domain."""

import signal

import pytest
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry

from omniman_ros.console.session import Session
from test.running import PATIENCE, PATIENT, Running, command, environment

pytestmark = pytest.mark.processes

NAMES = ("robot1", "robot2")
SHARED = {"/diagnostics", "/parameter_events", "/rosout"}


def test_of_two_robots_in_namespaces_only_the_one_that_is_driven_moves(own_domain):
    env = environment(own_domain)
    nodes = ("platform_controller", "simulated_drive")
    first, second = (
        command("up", *PATIENT, "--arm", "none", "--namespace", name, "--only", *nodes)
        for name in NAMES
    )
    with Running(first, env) as up1, Running(second, env) as up2, Session("probe") as session:
        positions = {}
        for name in NAMES:
            for topic in ("odom", "ground_truth/odom"):

                def on_odom(message, key=(name, topic)):
                    positions[key] = message.pose.pose.position.x

                session.node.create_subscription(Odometry, f"{name}/{topic}", on_odom, 10)
        assert session.wait(lambda: len(positions) == 4, PATIENCE)
        publisher = session.node.create_publisher(Twist, "robot2/cmd_vel", 1)
        forward = Twist()
        forward.linear.x = 0.3

        def has_moved():
            publisher.publish(forward)
            return min(positions["robot2", topic] for topic in ("odom", "ground_truth/odom")) > 0.2

        assert session.wait(has_moved, PATIENCE)
        assert [positions["robot1", topic] for topic in ("odom", "ground_truth/odom")] == [
            0.0,
            0.0,
        ]
        names = {name for name, _ in session.node.get_topic_names_and_types()}
        outside = {name for name in names if name.split("/")[1] not in NAMES}
        assert outside <= SHARED | {"/tf"}
        for up in (up1, up2):
            up.process.send_signal(signal.SIGINT)
            assert up.finish() == 0, up.output
