"""The journal of the platform controller over topics: it repeats the commands of the node."""

from collections import deque
from inspect import isroutine

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, UInt8MultiArray, UInt32MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.control.journal import Journal, read_chunk, replay, restore
from omniman_ros.conversions.motion_limits import motion_limit_message
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.nodes.journal_output import QUEUE, TICKS
from omniman_ros.nodes.stop_interface import LATCHED
from test.nodes.harness import PERIOD
from test.nodes.rig import Rig, reference

EVERY_INPUT = {"imu.use": True, "collision_monitor.use": True}


def drive_by_every_input(rig):
    """Use every way by which the node changes its core."""
    limit = rig.publisher(JointState, "motion_limit")
    imu, arm = rig.publisher(Imu, "imu"), rig.publisher(JointState, "arm/joint_states")
    restarts = rig.publisher(UInt32MultiArray, "wheel_restarts", LATCHED)
    button = rig.publisher(Bool, "emergency_stop", LATCHED)
    volts = rig.publisher(JointState, "mpc/voltages")
    path = rig.publisher(MultiDOFJointTrajectory, "path/reference")
    angle = [0.0]

    def each():
        limit.publish(motion_limit_message(0.8, 1.0, rig.stamp()))
        still = Quaternion(w=1.0)
        measured = Imu(orientation=still)
        measured.header.stamp, measured.header.frame_id = rig.stamp(), "imu_link"
        measured.linear_acceleration.z = 9.81
        imu.publish(measured)
        angle[0] += 0.002
        joints = JointState(name=list(UR_JOINTS), position=[angle[0]] * 6, velocity=[0.0] * 6)
        joints.header.stamp = rig.stamp()
        arm.publish(joints)

    rig.hooks.append(each)
    rig.drive(0.3, -0.1, 0.2)
    restarts.publish(UInt32MultiArray(data=[0, 0, 0, 0]))
    rig.run(0.1)
    restarts.publish(UInt32MultiArray(data=[0, 1, 0, 0]))
    rig.run(1.0)
    pose = PoseWithCovarianceStamped()
    pose.header.frame_id, pose.pose.pose.orientation.w = "odom", 1.0
    pose.pose.pose.position.x = 2.0
    rig.publisher(PoseWithCovarianceStamped, "set_pose").publish(pose)
    rig.run(0.8)
    x, y, theta = rig.core.odometry.pose
    poses = [(x + 0.2 * t, y, theta) for t in (0.0, 0.5)]
    path.publish(reference([0.0, 0.5], poses, [(0.2, 0.0, 0.0)] * 2, rig.stamp()))
    rig.run(1.5)
    gain = Parameter("coupling.authority", value=0.5).to_parameter_msg()
    rig.call(
        SetParameters,
        "platform_controller/set_parameters",
        SetParameters.Request(parameters=[gain]),
    )
    message = JointState(name=rig.names, effort=[3.0] * len(rig.names))
    for _ in range(20):
        message.header.stamp = rig.stamp()
        volts.publish(message)
        rig.run(0.02)
    button.publish(Bool(data=True))
    rig.run(1.5)
    assert not rig.call(Trigger, "platform_controller/reset").success
    button.publish(Bool(data=False))
    rig.run(0.1)
    rig.call(Trigger, "platform_controller/reset")
    rig.call(Trigger, "platform_controller/reset_odometry")
    rig.drive(0.2)
    peer = rig.publisher(DiagnosticStatus, "stop_state", LATCHED)
    peer.publish(DiagnosticStatus(name="/arm", level=DiagnosticStatus.ERROR, message="stopped"))
    rig.drive(0.2, seconds=0.5)
    rig.call(Trigger, "platform_controller/stop")
    rig.run(0.5)
    rig.node.begin_shutdown("test")
    rig.run(1.0)


def test_every_input_of_the_node_is_in_the_journal():
    with Rig(EVERY_INPUT) as rig:
        journal = Journal(rig.core)
        journal.open(1)
        drive_by_every_input(rig)
        chunk = read_chunk(journal.take())
        journal.close()
        core = restore(chunk)
        assert sum(1 for _ in replay(core, chunk.entries)) > 1500
        assert state(core) == state(rig.core)


def test_journal_on_the_topic_repeats_the_published_commands():
    with Rig() as rig:
        messages = rig.listen(UInt8MultiArray, "controller_journal", QUEUE)
        rig.drive(0.3, 0.1, -0.2)
        rig.node.begin_shutdown("test")
        rig.run(1.0)
        chunks = [read_chunk(bytes(message.data)) for message in messages]
        published = {_nanoseconds(message): message for message in rig.commands}
        core = restore(chunks[0])
        ticks = [tick for chunk in chunks for tick in replay(core, chunk.entries)]
        assert [chunk.number for chunk in chunks] == list(range(len(chunks)))
        for tick in ticks:
            expected = published.pop(tick.stamp)
            assert np.array(expected.effort).tobytes() == tick.command.effort.tobytes()
            assert np.array(expected.velocity).tobytes() == tick.command.velocity.tobytes()
        assert len(ticks) > 300
        assert max(published, default=0) < min(tick.stamp for tick in ticks)


def state(part):
    """Return all that an object knows, so that it can be compared bit for bit."""
    if isinstance(part, (np.ndarray, np.generic)):
        return part.tobytes()
    if isinstance(part, dict):
        return {key: state(value) for key, value in part.items() if not isroutine(value)}
    if isinstance(part, (list, tuple, deque)):
        return [state(item) for item in part]
    slots = [name for kind in type(part).__mro__ for name in getattr(kind, "__slots__", ())]
    known = {name: getattr(part, name) for name in slots} | getattr(part, "__dict__", {})
    return (type(part).__name__, state(known)) if known else repr(part)


def _nanoseconds(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def test_every_subscriber_gets_the_state_and_nobody_else_costs_anything():
    with Rig() as rig:
        core = vars(rig.core)
        rig.run(0.3)
        assert "tick" not in core
        first = rig.listen(UInt8MultiArray, "controller_journal", QUEUE)
        rig.run(0.3)
        assert "tick" in core
        second = rig.listen(UInt8MultiArray, "controller_journal", QUEUE)
        rig.run(0.3)
        chunks = [[read_chunk(bytes(m.data)) for m in each] for each in (first, second)]
        assert [bool(chunk.state) for chunk in chunks[0]].count(True) == 2
        assert [bool(chunk.state) for chunk in chunks[1]].count(True) == 1
        assert len(chunks[1]) >= 0.3 / (TICKS * PERIOD)
