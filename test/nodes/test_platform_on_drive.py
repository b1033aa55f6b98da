"""Controller and simulated drive as two nodes that share only their topics."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.nodes.stop_interface import LATCHED
from test import robots
from test.nodes.harness import World, last
from test.nodes.rig import twist


class Robot(World):
    """Both nodes with the ground truth of the wheels."""

    def __init__(self, robot: str = "omniman", parameters: dict | None = None) -> None:
        given = {"robot": robots.path(robot)} | (parameters or {})
        super().__init__(SimulatedDriveNode, PlatformControllerNode, parameters=given)
        self.drive, self.controller = self.nodes
        self.core = self.controller.core
        self.cmd_vel = self.publisher(Twist, "cmd_vel")
        self.truth = self.listen(Odometry, "ground_truth/odom")
        self.wheel_speeds: list[list[float]] = []
        self.hooks.append(
            lambda: self.wheel_speeds.append([w.speed for w in self.drive.drives._plant.wheels])
        )
        self.run(0.2)

    def go(self, x: float, y: float, turn: float, seconds: float) -> None:
        self.run(seconds, lambda: self.cmd_vel.publish(twist(x, y, turn)))

    def true_twist(self) -> np.ndarray:
        t = last(self.truth).twist.twist
        return np.array([t.linear.x, t.linear.y, t.angular.z])

    def set(self, node: str, name: str, value: object) -> None:
        parameter = value if isinstance(value, Parameter) else Parameter(name, value=value)
        request = SetParameters.Request(parameters=[parameter.to_parameter_msg()])
        result = self.call(SetParameters, f"{node}/set_parameters", request).results[0]
        assert result.successful, result.reason


def test_robot_tolerates_lost_and_late_wheel_states():
    with Robot() as world:
        world.set("simulated_drive", "faults.lost_messages", 0.33)
        world.set("simulated_drive", "faults.late_messages", 0.02)
        world.go(0.3, 0.1, 0.2, seconds=3.0)
        assert world.core.latch.released
        assert world.true_twist() == pytest.approx([0.3, 0.1, 0.2], abs=0.02)


def values(message):
    return {pair.key: pair.value for pair in message.values}


def test_dead_motor_stops_the_robot_and_is_reported():
    with Robot() as world:
        health = world.listen(DiagnosticStatus, "wheel_health", LATCHED)
        world.go(0.3, 0.0, 0.0, seconds=1.0)
        assert last(health).level == DiagnosticStatus.OK
        assert values(last(health))["torque"] == "measured"
        world.set("simulated_drive", "faults.dead_motor", ["front_left"])
        world.go(0.3, 0.0, 0.0, seconds=1.5)
        assert world.core.latch.status.reason == "wheel 'front_left' is dead: no torque"
        assert last(health).level == DiagnosticStatus.ERROR
        assert values(last(health))["front_left"] == "dead"
        assert np.abs(world.true_twist()).max() < 1e-3


def repair(world: Robot) -> None:
    """Give the motors their torque back, stop, and reset both nodes."""
    repaired = Parameter("faults.dead_motor", Parameter.Type.STRING_ARRAY, [])
    world.set("simulated_drive", "faults.dead_motor", repaired)
    world.go(0.0, 0.0, 0.0, seconds=1.0)
    for node in ("simulated_drive", "platform_controller"):
        assert world.call(Trigger, f"{node}/reset").success
    world.go(0.0, 0.0, 0.0, seconds=0.1)


def test_three_wheels_drive_on_until_repair_and_reset():
    with Robot(parameters={"drive.dead_wheel": "drive_on"}) as world:
        health = world.listen(DiagnosticStatus, "wheel_health", LATCHED)
        report = world.listen(DiagnosticArray, "/diagnostics")
        world.go(0.3, 0.1, 0.0, seconds=1.0)
        world.set("simulated_drive", "faults.dead_motor", ["rear_left"])
        world.go(0.3, 0.1, 0.0, seconds=1.5)
        assert world.true_twist() == pytest.approx([0.3, 0.1, 0.0], abs=0.02)
        note = "wheel 'rear_left' is dead: driving on without"
        assert (last(health).level, last(health).message) == (DiagnosticStatus.WARN, note)
        assert values(last(health)) == {
            "front_left": "driving",
            "front_right": "driving",
            "rear_left": "idle",
            "rear_right": "driving",
            "torque": "measured",
            "limits": "0.5",
            "posture_limits": "1",
        }
        ours = [s for m in report for s in m.status if "platform_controller" in s.name][-1]
        assert (ours.level, ours.message) == (DiagnosticStatus.WARN, note)
        odom, truth = world.core.odometry.pose, world.drive.drives.ground_truth()[0]
        assert odom == pytest.approx(truth.tolist(), abs=0.02)
        world.go(5.0, 0.0, 0.0, seconds=2.5)
        assert world.true_twist()[0] == pytest.approx(0.5, abs=0.02), "half of the velocity limit"
        repair(world)
        world.go(0.3, 0.0, 0.0, seconds=1.5)
        assert last(health).level == DiagnosticStatus.OK
        assert world.core.wheel_health.idle == ()
