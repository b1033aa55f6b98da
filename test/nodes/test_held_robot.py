"""A held robot and an inertial sensor over real topics, on simulated time."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, JointState
from std_srvs.srv import Trigger

from omniman_ros.nodes.odometry import OdometryNode
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.nodes.stop_interface import LATCHED
from test import robots
from test.nodes.harness import World, last
from test.nodes.rig import twist

WALL = """
walls:
  - {name: wall, x: [0.85, 0.85], y: [-3, 3], height: 0.35}
"""


class Robot(World):
    """Nodes of a robot, and its diagnostics."""

    def __init__(self, *makers, **parameters):
        named = {name.replace("__", "."): value for name, value in parameters.items()}
        super().__init__(*makers, parameters={"robot": robots.path("omniman")} | named)
        self.diagnostics = self.listen(DiagnosticArray, "/diagnostics", 1000)

    def values(self, node):
        """Return level, message and values of the latest diagnostics of a node."""
        named = [s for m in self.diagnostics for s in m.status if s.name == f"/{node}"]
        status = last(named)
        return status.level, status.message, {item.key: item.value for item in status.values}

    def set(self, node, name, value):
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        result = self.call(SetParameters, f"{node}/set_parameters", request).results[0]
        assert result.successful, result.reason


def test_a_robot_that_drives_into_a_wall_stops_latched_and_says_so(tmp_path):
    pytest.importorskip("mujoco")
    from omniman_ros.nodes.simulated_world import SimulatedWorldNode

    path = tmp_path / "scene.yaml"
    path.write_text(WALL)
    given = {"scene": str(path), "world__wheels": "ideal"}
    with Robot(SimulatedWorldNode, PlatformControllerNode, **given) as robot:
        stops = robot.listen(DiagnosticStatus, "stop_state", LATCHED)
        cmd_vel = robot.publisher(Twist, "cmd_vel")
        simulated, controller = robot.nodes
        robot.run(0.2)

        def drive():
            cmd_vel.publish(twist(0.4, 0.0, 0.0))

        def touches():
            drive()
            return bool(simulated.world.contacts)

        robot.run_until(touches, 3.0, "the wall")
        delay = robot.run_until(
            lambda: drive() or not controller.core.latch.released, 1.0, "the stop"
        )
        assert delay <= 1.0
        robot.run(1.5, drive)
        (stop,) = [m for m in stops if m.level == DiagnosticStatus.ERROR]
        assert stop.name == "/platform_controller"
        assert stop.message.startswith("stopped: the robot is held: its motors push with ")
        level, message, values = robot.values("platform_controller")
        assert level == DiagnosticStatus.ERROR and message.startswith("the robot is held")
        assert values["held"] == "True"
        assert np.abs(simulated.drives.wheel_states(robot.time).velocity).max() < 0.05
        robot.run(1.5)  # the stream falls silent
        assert robot.call(Trigger, "platform_controller/reset").success
        robot.run(1.0)
        assert controller.core.latch.released and controller.core.at_rest
        assert robot.values("platform_controller")[2]["held"] == "False"


def test_the_simulated_sensor_shows_the_motion_and_gravity():
    with Robot(SimulatedDriveNode, imu__yaw=0.5, imu__frame="sensor") as robot:
        messages = robot.listen(Imu, "imu")
        robot.run(1.0)
        assert len(messages) == pytest.approx(100, abs=2)
        message = last(messages)
        assert message.header.frame_id == "sensor"
        assert message.orientation_covariance[0] == -1.0
        assert message.linear_acceleration.z == pytest.approx(9.81, abs=0.1)
        robot.set("simulated_drive", "imu_sensor.silent", True)
        count = len(messages)
        robot.run(0.2)
        assert len(messages) <= count + 1
        robot.set("simulated_drive", "imu_sensor.silent", False)
        robot.set("simulated_drive", "imu_sensor.frozen", True)
        robot.run(0.2)
        rates = {m.angular_velocity.z for m in messages[-10:]}
        assert len(rates) == 1


@pytest.mark.parametrize("kind", [PlatformControllerNode, OdometryNode])
def test_the_heading_follows_the_sensor_and_without_it_the_wheels(kind):
    # Nobody commands these wheels.
    with Robot(kind, imu__use=True, drive__following_error=100.0) as robot:
        (node,) = robot.nodes
        name = node.get_name()
        imu = robot.publisher(Imu, "imu")
        states = robot.publisher(JointState, "wheel_states")
        odom = robot.listen(Odometry, "odom")
        position = np.zeros(4)

        def measure(rate=0.0, frame="imu_link"):
            message = Imu()
            message.header.stamp, message.header.frame_id = robot.stamp(), frame
            message.angular_velocity.z = rate + 1e-6 * math.sin(robot.time)
            message.linear_acceleration.z = 9.81
            imu.publish(message)

        def report(turn=0.0):
            speeds = robots.kinematics().J @ np.array([0.0, 0.0, turn])
            position[:] += speeds * 0.005
            states.publish(wheel_states(robot.stamp(), position, speeds))

        robot.run(1.0, lambda: (measure(), report()))
        robot.run(1.0, lambda: (measure(0.4), report(0.5)))
        heading = node.core.odometry.pose[2]
        assert heading == pytest.approx(0.4, abs=0.02)
        assert last(odom).twist.twist.angular.z == pytest.approx(0.4, abs=0.02)
        assert robot.values(name)[2]["imu"] == "used"
        robot.run(0.5, lambda: (measure(0.4, "base_link"), report(0.5)))
        assert node.warning_counts["imu"] > 0
        robot.run(1.5, lambda: (measure(math.nan), report(0.5)))
        level, message, values = robot.values(name)
        assert level == DiagnosticStatus.WARN and "imu silent" in message
        assert "imu silent" in values["imu"]
        assert node.core.odometry.pose[2] - heading == pytest.approx(0.99, abs=0.03)


def wheel_states(stamp, position, speeds):
    message = JointState(
        name=list(robots.robot().wheels.names),
        position=position.tolist(),
        velocity=speeds.tolist(),
    )
    message.header.stamp = stamp
    return message
