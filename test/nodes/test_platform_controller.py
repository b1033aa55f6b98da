"""The node over real topics, on simulated time, with an ideal drive."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, TwistStamped
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.core.parameters import specs
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.platform_controller import (
    PlatformControllerNode,
    PlatformControllerParameters,
)
from omniman_ros.nodes.stop_interface import LATCHED
from test.nodes.harness import PERIOD, World, last
from test.nodes.rig import Rig, reference, twist
from test.tiers import exhaustive

NAN, INF = math.nan, math.inf
STOP_TIME = 1.2  # 0.5 m/s at 1.2 m/s^2 and 0.6 rad/s at 2 rad/s^2, plus a margin


@pytest.fixture
def rig():
    with Rig() as rig:
        yield rig


def straight(rig: Rig, speed: float = 0.4, seconds: float = 0.5) -> MultiDOFJointTrajectory:
    """Return a preview along x from the robot's pose, at constant speed from its start."""
    x, y, theta = rig.core.odometry.pose
    times = [0.0, seconds]
    poses = [(x + speed * t, y, theta) for t in times]
    return reference(times, poses, [(speed, 0.0, 0.0)] * 2, rig.stamp())


# ---- driving ----------------------------------------------------------------------------------


def test_cmd_vel_drives_the_commanded_twist(rig):
    rig.drive(0.3, -0.2, 0.4, seconds=1.5)
    speeds = rig.speeds()[-1]
    assert rig.core.cascade.kinematics.J_pinv @ speeds == pytest.approx([0.3, -0.2, 0.4], abs=1e-6)
    message = last(rig.odom)
    assert message.header.frame_id == "odom" and message.child_frame_id == "base_link"
    assert message.twist.twist.linear.x == pytest.approx(0.3, abs=1e-6)
    assert message.twist.twist.linear.y == pytest.approx(-0.2, abs=1e-6)
    assert message.twist.twist.angular.z == pytest.approx(0.4, abs=1e-6)


def test_topics_are_published_at_200_100_and_50_hz(rig):
    coupling = rig.listen(JointState, "coupling_error")
    before = len(rig.commands), len(rig.odom), len(coupling)
    rig.run(1.0)
    after = len(rig.commands), len(rig.odom), len(coupling)
    counts = [b - a for a, b in zip(before, after, strict=True)]
    assert counts == pytest.approx([200, 100, 50], abs=1)
    assert list(last(coupling).name) == ["constraint_1", "constraint_1_total"]


def test_stamped_cmd_vel_is_selected_by_parameter():
    with World(PlatformControllerNode, parameters={"cmd_vel_stamped": True}) as world:
        publisher = world.publisher(TwistStamped, "cmd_vel")
        states = world.publisher(JointState, "wheel_states")
        core = world.nodes[0].core
        names = list(core.parameters.robot.wheels.names)

        def feed(frame: str, age: float) -> None:
            state = JointState(name=names, position=[0.0] * 4, velocity=[0.0] * 4)
            state.header.stamp = world.stamp()
            states.publish(state)
            message = TwistStamped(twist=twist(0.1))
            message.header.stamp, message.header.frame_id = world.stamp(-age), frame
            publisher.publish(message)

        for frame, age in (("map", 0.0), ("base_link", 0.7), ("base_link", -0.2)):
            world.run(0.2, lambda frame=frame, age=age: feed(frame, age))
            assert core.at_rest, f"frame {frame}, age {age} must cause no motion"
        world.run(0.2, lambda: feed("base_link", 0.1))
        assert not core.at_rest


# ---- arbitration ------------------------------------------------------------------------------


def test_mpc_has_priority_over_path(rig):
    active = rig.listen(String, "active_source", LATCHED)
    path = rig.publisher(MultiDOFJointTrajectory, "path/reference")
    mpc = rig.publisher(MultiDOFJointTrajectory, "mpc/reference")
    rig.run(0.2, lambda: path.publish(straight(rig)))
    rig.run(0.2, lambda: (path.publish(straight(rig)), mpc.publish(straight(rig))))
    assert [m.data for m in active] == ["none", "path", "mpc"]


def test_mpc_voltages_pass_and_a_stop_uses_velocity_mode(rig):
    publisher = rig.publisher(JointState, "mpc/voltages")

    def send() -> None:
        message = JointState(name=rig.names, effort=[3.0, 4.0, 5.0, 600.0])
        message.header.stamp = rig.stamp()
        publisher.publish(message)

    rig.run(0.1, send)
    assert list(last(rig.volts).effort) == [3.0, 4.0, 5.0, 48.0]
    count = len(rig.volts)
    rig.run(0.5)
    assert len(rig.volts) - count <= 0.1 / PERIOD + 2
    assert list(last(rig.commands).velocity) == [0.0] * 4


@pytest.mark.parametrize("mode", ["velocity", "torque", "voltage"])
def test_output_mode_selects_the_drive_command(mode):
    with Rig({"drive.mode": mode}) as rig:
        count = len(rig.commands), len(rig.volts)
        rig.drive(0.3, seconds=0.3)
        commands, volts = rig.commands[count[0] :], rig.volts[count[1] :]
        if mode == "voltage":
            assert len(volts) > 50 and max(last(volts).effort) > 0.0
        elif mode == "torque":
            assert len(last(commands).velocity) == 0 and max(last(commands).effort) > 0.0
        else:
            assert min(last(commands).velocity) > 0.5 and not volts
        rig.assert_stops(len(rig.commands) + 110, within=STOP_TIME)


# ---- stops ------------------------------------------------------------------------------------


def stale(rig: Rig) -> float:
    return 0.5


def stop_service(rig: Rig) -> float:
    assert rig.call(Trigger, "platform_controller/stop").success
    return 0.0


def emergency(rig: Rig) -> float:
    rig.publisher(Bool, "emergency_stop").publish(Bool(data=True))
    return 0.0


def emergency_latched(rig: Rig) -> float:
    qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    rig.publisher(Bool, "emergency_stop", qos).publish(Bool(data=True))
    return 0.0


def dead_wheel_states(rig: Rig) -> float:
    rig.drive_alive = False
    return 0.2


def peer_stopped(rig: Rig) -> float:
    peer = DiagnosticStatus(level=DiagnosticStatus.ERROR, name="/arm_streamer", message="stopped")
    rig.publisher(DiagnosticStatus, "stop_state", LATCHED).publish(peer)
    return 0.0


def shutdown(rig: Rig) -> float:
    rig.node.begin_shutdown("SIGTERM")
    return 0.0


WAYS = [
    stale,
    stop_service,
    emergency,
    emergency_latched,
    dead_wheel_states,
    peer_stopped,
    shutdown,
]


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)
@pytest.mark.parametrize(
    "direction", [exhaustive((0.5, 0.0, 0.0)), (-0.2, 0.4, -0.6)], ids=["x", "mixed"]
)
def test_every_cause_of_a_stop_ramps_every_wheel_to_zero(rig, way, direction):
    rig.drive(*direction, seconds=1.5)
    assert np.abs(rig.speeds()[-1]).min() > 0.1
    since = len(rig.commands) - 1
    rig.assert_stops(since, within=way(rig) + STOP_TIME)


def test_reset_is_refused_while_one_of_two_emergency_stops_is_true(rig):
    buttons = [rig.probe.create_publisher(Bool, "emergency_stop", LATCHED) for _ in range(2)]
    rig.run_until(lambda: all(b.get_subscription_count() == 2 for b in buttons), 5.0, "a match")
    buttons[0].publish(Bool(data=True))
    rig.run(0.1)
    for _ in range(3):
        buttons[1].publish(Bool(data=False))
        rig.run(0.1)
    assert not rig.call(Trigger, "platform_controller/reset").success
    buttons[0].publish(Bool(data=False))
    rig.run(0.1)
    assert rig.call(Trigger, "platform_controller/reset").success


def test_that_the_robot_is_ready_is_logged_once(capfd):
    with World(PlatformControllerNode) as world:
        world.run(0.5)
        assert "ready" not in capfd.readouterr().err, "no wheel_states"
    with Rig({"cmd_vel_stamped": False}) as rig:
        rig.drive(0.3)
        assert rig.call(Trigger, "platform_controller/stop").success
        rig.run(1.0)
        assert rig.call(Trigger, "platform_controller/reset").success
        rig.drive(0.3)
    said = [line for line in capfd.readouterr().err.splitlines() if "ready: " in line]
    assert len(said) == 1
    assert "drive with /cmd_vel (geometry_msgs/msg/Twist)" in said[0]


# ---- invalid input ----------------------------------------------------------------------------


def test_rejected_cmd_vel_does_not_count_as_fresh(rig):
    rig.drive(0.3, seconds=0.5)
    since = len(rig.commands)
    rig.run(1.5, lambda: rig.cmd_vel.publish(twist(NAN)))
    assert not rig.speeds(since)[-1].any()


@pytest.mark.parametrize(("ahead", "speed"), [(0.0, NAN), (-3.0, 0.0), (1.0, 0.0)])
def test_invalid_wheel_states_never_count_as_fresh(rig, ahead, speed):
    rig.drive(0.3, seconds=0.5)
    rig.drive_alive = False
    since = len(rig.commands) - 1
    pose = rig.core.odometry.pose

    def send() -> None:
        message = rig.wheel_state([0.0] * 4, [speed, 0.0, 0.0, 0.0])
        message.header.stamp = rig.stamp(ahead)
        rig._states.publish(message)

    rig.hooks.append(send)
    rig.assert_stops(since, within=0.2 + STOP_TIME)
    assert "wheel_states" in rig.core.latch.status.reason
    assert rig.core.odometry.pose == pytest.approx(pose, abs=0.01)


def test_fuzzed_messages_cause_no_crash_and_no_motion():
    rng = np.random.default_rng(7)
    pool = [NAN, INF, -INF, 1e308, -1e308, 5e-324, 0.0, 1.0]
    with Rig() as rig:
        voltages = rig.publisher(JointState, "mpc/voltages")
        path = rig.publisher(MultiDOFJointTrajectory, "path/reference")
        pose = rig.publisher(PoseWithCovarianceStamped, "set_pose")

        def numbers(count: int) -> list[float]:
            values = [float(v) for v in rng.choice(pool, count)]
            values[rng.integers(count)] = NAN
            return values

        def send() -> None:
            names = [str(n) for n in rng.choice([*rig.names, "", "x"], rng.integers(0, 6))]
            size = int(rng.integers(1, 6))
            rig._states.publish(
                JointState(name=names, position=numbers(size), velocity=numbers(size))
            )
            voltages.publish(JointState(name=rig.names, effort=numbers(4)))
            rig.cmd_vel.publish(twist(*numbers(3)))
            points = int(rng.integers(0, 4))
            triples = [numbers(3) for _ in range(points)]
            times = [abs(v) if abs(v) < 2 else 1.0 for v in rng.normal(size=points)]
            path.publish(reference(times, triples, triples, rig.stamp()))
            message = PoseWithCovarianceStamped()
            message.header.frame_id = "odom"
            message.pose.pose.position.x, message.pose.pose.position.y = numbers(2)
            message.pose.pose.orientation.w = numbers(1)[0]
            pose.publish(message)

        since = len(rig.commands)
        rig.run(2.0, send)
        assert len(rig.commands) - since == pytest.approx(400, abs=1)
        assert not rig.speeds(since).any()
        assert rig.core.odometry.pose == (0.0, 0.0, 0.0)


def test_garbage_on_the_wire_causes_no_crash(rig):
    from rclpy.serialization import serialize_message

    rng = np.random.default_rng(3)
    good = {
        rig.cmd_vel: serialize_message(twist(NAN, NAN, NAN)),
        rig._states: serialize_message(rig.wheel_state([NAN] * 4, [NAN] * 4)),
    }

    def send() -> None:
        for publisher, wire in good.items():
            broken = bytearray(wire[: rng.integers(4, len(wire) + 1)])
            broken[rng.integers(4, len(broken)) if len(broken) > 4 else 0] ^= 1 << rng.integers(8)
            publisher.publish(bytes(broken))

    since = len(rig.commands)
    rig.run(1.0, send)
    assert len(rig.commands) - since == pytest.approx(200, abs=1)


def test_warnings_are_rate_limited(rig):
    rig.run(3.0, lambda: rig.cmd_vel.publish(twist(NAN)))
    counts = rig.node.warning_counts
    assert counts["cmd_vel"] >= 590
    report = rig.listen(DiagnosticArray, "/diagnostics")
    rig.run(1.1)
    values = {v.key: v.value for v in last(report).status[0].values}
    assert int(values["warned: cmd_vel"]) >= 590


# ---- odometry ---------------------------------------------------------------------------------


# ---- parameters -------------------------------------------------------------------------------


def set_parameter(rig: Rig, name: str, value: object) -> object:
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    return rig.call(SetParameters, "platform_controller/set_parameters", request).results[0]


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("limits.linear_velocity", -1.0, "range"),
        ("limits.linear_velocity", NAN, "range"),
        ("coupling.k_epsilon", 1e9, "range"),
        ("drive.mode", "magic", "drive.mode"),
        ("wheels.radius", [0.1], "read-only"),
        ("odometry.wheel_scale", [1.0, 1.0], "odometry.wheel_scale"),
        ("friction.coulomb", [-1.0], "friction.coulomb"),
        ("timeouts.cmd_vel", 0.0, "range"),
    ],
)
def test_invalid_values_are_rejected_at_runtime_with_a_reason(rig, name, value, word):
    before = rig.node.settings.value
    result = set_parameter(rig, name, value)
    assert not result.successful
    assert word in result.reason, result.reason
    assert rig.node.settings.value == before


def test_limits_change_at_runtime(rig):
    assert set_parameter(rig, "limits.linear_velocity", 0.2).successful
    rig.drive(0.9, seconds=2.0)
    assert (rig.core.cascade.kinematics.J_pinv @ rig.speeds()[-1])[0] == pytest.approx(0.2)


@pytest.mark.parametrize(
    "given",
    [
        {"limits.linear_velocity": -2.0},
        {"wheels.radius": [0.1, 0.1]},
        {"robot": "nobody"},
        {"coupling.k_epsilon": "2"},
        {"wheels.roller_angle": [math.pi / 2, 0.785, 0.785, -0.785]},
    ],
    ids=lambda given: next(iter(given)),
)
def test_invalid_value_at_start_is_rejected_naming_the_parameter(given):
    from omniman_ros.core.errors import OmnimanError

    with pytest.raises(OmnimanError) as caught:
        World(PlatformControllerNode, parameters=given)
    name = next(iter(given))
    assert name.split(".")[-1] in str(caught.value) or "front_left" in str(caught.value)


def test_every_parameter_is_declared_with_description_and_range(rig):
    names = [spec.name for spec in specs(PlatformControllerParameters)]
    answer = rig.call(
        DescribeParameters,
        "platform_controller/describe_parameters",
        DescribeParameters.Request(names=names),
    )
    by_name = {d.name: d for d in answer.descriptors}
    for spec in specs(PlatformControllerParameters):
        told = by_name[spec.name]
        assert told.description.startswith(spec.doc)
        assert told.read_only == spec.read_only
        if spec.kind is float:
            bounds = told.floating_point_range[0]
            assert bounds.from_value == spec.low or spec.low is None
            assert bounds.to_value == spec.high or spec.high is None


def test_robot_given_as_parameters_uses_no_file():
    seen = {}

    def make(**options):
        node = PlatformControllerNode(**options)
        seen["set"] = node.settings
        return node

    from omniman_ros.robots import robot_parameters

    given = {
        name: list(v) if isinstance(v, (list, tuple)) else v
        for name, v in robot_parameters("ig42").items()
    }
    with World(make, parameters=given):
        robot = seen["set"].value.platform.robot
        assert robot.body.mass == 25.0 and robot.arm.inertia == 0.0
    assert isinstance(seen["set"], ParameterSet)


def test_backward_jump_of_simulated_time_stops_and_allows_a_new_start(rig):
    rig.drive(0.3, seconds=1.0)
    rig.time -= 900.0
    since = len(rig.commands)
    rig.drive(0.3, seconds=1.0)
    assert not rig.speeds(since)[-1].any(), "the earlier stream continued to drive"
    rig.run(1.1)
    assert not rig.speeds(since)[-1].any()
    rig.drive(0.3, seconds=0.3)
    assert rig.speeds()[-1].all(), "a new start after time went back"


# ---- extreme inputs ---------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["velocity", "torque", "voltage"])
def test_absurd_acceleration_in_a_preview_stays_within_the_limits(mode):
    from geometry_msgs.msg import Twist as Acceleration

    with Rig({"drive.mode": mode}) as rig:
        publisher = rig.publisher(MultiDOFJointTrajectory, "path/reference")
        message = reference([0, 0.5], [(0, 0, 0)] * 2, [(0, 0, 0)] * 2, rig.stamp())
        for point in message.points:
            point.accelerations = [Acceleration()]
            point.accelerations[0].linear.x = 9e4
        since = len(rig.commands)
        publisher.publish(message)
        rig.run(0.4)
        limit = rig.core.cascade.dynamics.torque_limit.max()
        efforts = [max(map(abs, c.effort)) for c in rig.commands[since:] if c.effort]
        assert max(efforts) <= limit + 1e-9


def unstamped_preview(rig: Rig) -> MultiDOFJointTrajectory:
    message = straight(rig, seconds=1.0)
    message.header.stamp = Time()
    return message


@pytest.mark.parametrize(
    ("kind", "topic", "message"),
    [
        (Twist, "cmd_vel", lambda rig: twist(0.5)),
        (MultiDOFJointTrajectory, "path/reference", unstamped_preview),
    ],
    ids=["twist", "preview"],
)
@pytest.mark.parametrize("is_tick_first", [False, True], ids=["message first", "tick first"])
def test_unstamped_setpoint_that_waited_in_its_queue_does_not_drive(
    rig, kind, topic, message, is_tick_first
):
    publisher = rig.publisher(kind, topic)
    rig.run(0.1)
    rig.time += 2.0  # no callback is served
    rig.drive_alive = False
    if is_tick_first:
        rig.run(PERIOD)
        publisher.publish(message(rig))
    else:
        timers = list(rig.node.timers)
        for timer in timers:
            timer.cancel()
        publisher.publish(message(rig))
        rig.run(PERIOD)
        for timer in timers:
            timer.reset()
    rig.drive_alive = True
    since = len(rig.commands)
    rig.run(0.5)
    assert rig.core.latch.released
    assert not rig.speeds(since).any()
    publisher.publish(message(rig))
    rig.run(0.2)
    assert rig.speeds()[-1].all(), "the next one drives"


def test_flood_of_previews_does_not_delay_the_tick(rig):
    path = rig.publisher(MultiDOFJointTrajectory, "path/reference")
    before = len(rig.commands)
    rig.run(0.5, lambda: [path.publish(straight(rig)) for _ in range(5)])
    assert len(rig.commands) - before == pytest.approx(100, abs=1)


def test_wheel_calibration_changes_only_at_rest(rig):
    rig.drive(0.5, seconds=0.5)
    refused = set_parameter(rig, "odometry.wheel_scale", [0.9])
    assert not refused.successful and "odometry.wheel_scale" in refused.reason
    rig.run(1.5)
    assert set_parameter(rig, "odometry.wheel_scale", [0.9]).successful
