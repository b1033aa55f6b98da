"""Topics and life cycle of the arm streamer, on stepped time with a simulated controller.

The node's streaming process is a stand-in that runs the real loop and policy in the test. Real
processes and sockets are tested end to end (test/end_to_end/test_arm_processes.py).
"""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.conversions.headers import duration_message
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.arm_streamer import ArmStreamerNode
from omniman_ros.nodes.hardware_node import RETRY_PERIOD
from omniman_ros.nodes.stop_interface import ALL_LATCHED, LATCHED
from omniman_ros.simulation.ur.arm import CYCLE
from omniman_ros.simulation.ur.modes import UNLOCK_DELAY, Cb3RobotMode, Cb3SafetyMode
from omniman_ros.ur.parameters import UrParameters
from omniman_ros.ur.streaming_client import HANG_TIMEOUT
from test.nodes.harness import World
from test.nodes.stepped_arm import SteppedArm

NODE = "/arm_streamer"
TIMEOUT = 5.0
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
STILL = 1e-3  #: Largest further travel of an arm that stands [rad]
PREVIEW_PERIOD = 0.04  #: Time between two previews [s]
AMPLITUDE, RATE = 0.3, 1.5
"""Amplitude [rad] and angular frequency [rad/s] of the motion of all joints."""


class Bench(World):
    """A streamer with its stepped arm, and a probe that can move the arm.

    Args:
        unreachable: Why the controller cannot be reached, or an empty string.

    Attributes:
        arm: The simulated controller and the streaming process.
        node: The node under test.
    """

    def __init__(self, unreachable="", **parameters):
        self.arm = SteppedArm()
        self.arm.blocking_reason = unreachable
        self.arm.pass_time = self._pass_time
        super().__init__(self._make, parameters={"simulated_controller": True} | parameters)
        self.hooks.append(lambda: self.arm.advance(self.time))
        self.node = self.nodes[0]
        self.previews = self.publisher(JointTrajectory, "arm/joint_reference", 1)
        self._stops = self.listen(DiagnosticStatus, "stop_state", ALL_LATCHED)
        self._way = 1.0

    def _make(self, **options):
        return ArmStreamerNode(start_process=self.arm.start_process, **options)

    def _pass_time(self, seconds):
        self.time += seconds
        for node in [*self.nodes, self.probe]:
            self._set_time(node)
        self.arm.advance(self.time)

    def until(self, condition, what):
        return self.run_until(condition, TIMEOUT, f"{what}: {self.node.status()}")

    def streams(self):
        return self.node.status()[:2] == (OK, "streaming")

    @property
    def stop_state(self):
        return [message.message for message in self._stops if message.name == NODE][-1]

    @property
    def state(self):
        return self.call(GetState, "arm_streamer/get_state").current_state.id

    def change(self, transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.call(ChangeState, "arm_streamer/change_state", request).success

    def trigger(self, name):
        return self.call(Trigger, f"arm_streamer/{name}")

    def set(self, **values):
        changes = [Parameter(n.replace("__", "."), value=value) for n, value in values.items()]
        return self.node.set_parameters(changes)

    def preview(self, place, times=(0.0, 0.4), names=UR_JOINTS, ahead=0.0):
        """Return a preview; `place` maps a time since the stamp to angles and speeds."""
        message = JointTrajectory(joint_names=list(names))
        message.header.stamp = self.stamp(ahead)
        for t in times:
            angles, speeds = place(t)
            message.points.append(
                JointTrajectoryPoint(
                    positions=[*map(float, angles)],
                    velocities=[*map(float, speeds)],
                    time_from_start=duration_message(t),
                )
            )
        return message

    def move(self, seconds):
        """Publish the previews of a motion, in alternating directions, for some time."""
        begin, home = self.time, self.arm.place
        self._way = -self._way
        amplitude = self._way * AMPLITUDE
        for _ in range(round(seconds / PREVIEW_PERIOD)):
            since = self.time - begin

            def place(t, since=since):
                angle = RATE * (since + t)
                offset, speed = 1.0 - math.cos(angle), RATE * math.sin(angle)
                return home + amplitude * offset, np.full(6, amplitude * speed)

            self.previews.publish(self.preview(place, np.arange(0.0, 0.6, 0.02)))
            self.run(PREVIEW_PERIOD)

    def swing(self):
        """Bring the arm into motion."""
        self.until(self.streams, "streaming")
        self.move(0.6)
        assert self.arm.speed > 0.3

    def assert_stands(self, reason):
        """Assert that the arm is stopped for a reason and stays at rest despite new previews."""
        self.until(self.arm.rests, "rest")
        self.run(0.1)
        place = self.arm.place
        self.move(0.6)
        assert np.abs(self.arm.place - place).max() < STILL
        assert self.stop_state.startswith("stopped: ")
        assert reason in self.stop_state
        level, message, _ = self.node.status()
        assert level == ERROR
        assert reason in message

    def assert_goes_on(self):
        """Assert that a reset is granted and moves nothing, and that previews then do."""
        place = self.arm.place
        answer = self.trigger("reset")
        assert answer.success, answer.message
        self.until(self.streams, "streaming")
        self.run(0.2)
        assert np.abs(self.arm.place - place).max() < STILL, "a reset starts no motion"
        self.swing()


def test_streamer_starts_itself_moves_the_arm_and_reports():
    with Bench() as bench:
        states = bench.listen(JointState, "arm/joint_states")
        scaling = bench.listen(Float64, "arm/speed_scaling")
        timing = bench.listen(Float64MultiArray, "arm/timing")
        diagnostics = bench.listen(DiagnosticArray, "/diagnostics")
        bench.swing()
        message = states[-1]
        assert tuple(message.name) == UR_JOINTS
        assert max(map(abs, message.velocity)) == pytest.approx(bench.arm.speed, rel=0.1)
        sent = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        assert 0.0 <= bench.time - sent < 2 * CYCLE
        intervals, ages = timing[-1].layout.dim
        assert (intervals.label, ages.label) == ("intervals", "ages")
        assert intervals.size >= 25 and ages.size > 0
        assert len(timing[-1].data) == intervals.size + ages.size
        assert timing[-1].data[: intervals.size] == pytest.approx([CYCLE] * intervals.size)
        bench.run(1.0)
        (status,) = diagnostics[-1].status
        assert (status.name, status.level, status.message) == (NODE, OK, "streaming")
        for slider in (0.5, 1.0):
            bench.arm.controller.slider = slider
            bench.until(lambda s=slider: scaling[-1].data == s, "the speed slider")
        bench.trigger("stop")
        bench.until(lambda: scaling[-1].data == 0.0, "an arm that does not move is told as 0")
        (status,) = diagnostics[-1].status
        assert (status.level, status.message) == (ERROR, "~/stop")


def test_preview_that_the_streaming_process_refuses_is_a_warning():
    with Bench() as bench:
        bench.until(bench.streams, "streaming")
        far = bench.arm.place + 1.0
        bench.previews.publish(bench.preview(lambda t: (far, np.zeros(6))))
        bench.until(lambda: bench.node.warning_counts, "a warning")
        assert bench.node.warning_counts == {"arm/joint_reference": 1}


def test_life_cycle_connects_holds_stops_and_disconnects():
    with Bench(autostart=False) as bench:
        arm = bench.arm
        states = bench.listen(JointState, "arm/joint_states")
        scaling = bench.listen(Float64, "arm/speed_scaling")
        assert bench.state == State.PRIMARY_STATE_UNCONFIGURED
        assert bench.change(Transition.TRANSITION_CONFIGURE)
        assert not arm.plays()
        bench.until(lambda: states, "joint states before it is active")
        bench.previews.publish(bench.preview(lambda t: (arm.place, np.zeros(6))))
        bench.run(0.1)
        assert bench.node.warning_counts == {"arm/joint_reference refused": 1}
        assert not scaling
        assert bench.change(Transition.TRANSITION_ACTIVATE)
        assert bench.state == State.PRIMARY_STATE_ACTIVE
        assert arm.plays()
        bench.swing()
        assert bench.change(Transition.TRANSITION_DEACTIVATE)
        bench.until(lambda: not arm.plays() and arm.rests(), "rest, and the program's end")
        assert not arm.process.has_ended
        assert bench.change(Transition.TRANSITION_CLEANUP)
        assert arm.process.has_ended
        assert bench.state == State.PRIMARY_STATE_UNCONFIGURED
        assert bench.change(Transition.TRANSITION_CONFIGURE)
        assert bench.change(Transition.TRANSITION_ACTIVATE)
        bench.swing()


def test_invalid_transition_is_refused_and_streaming_continues():
    with Bench() as bench:
        bench.until(bench.streams, "streaming")
        for wrong in (
            Transition.TRANSITION_CONFIGURE,
            Transition.TRANSITION_ACTIVATE,
            Transition.TRANSITION_CLEANUP,
            200,
        ):
            assert not bench.change(wrong)
        assert bench.state == State.PRIMARY_STATE_ACTIVE
        bench.swing()


def test_stop_that_is_reset_while_inactive_does_not_return():
    with Bench() as bench:
        bench.until(bench.streams, "streaming")
        bench.trigger("stop")
        bench.until(lambda: bench.node.streaming.report.stop_reason, "the stop")
        assert bench.change(Transition.TRANSITION_DEACTIVATE)
        assert not bench.change(Transition.TRANSITION_ACTIVATE), "the streamer is stopped"
        assert bench.trigger("reset").success
        bench.run(0.2)
        assert bench.node.latch.released
        assert bench.change(Transition.TRANSITION_ACTIVATE)
        bench.swing()


def test_failed_activation_can_be_retried_at_once():
    with Bench(autostart=False) as bench:
        assert bench.change(Transition.TRANSITION_CONFIGURE)
        bench.arm.controller.power(Cb3RobotMode.POWER_OFF)
        bench.run(0.1)
        assert "power off" in bench.node.streaming.report.blocking_reason
        assert not bench.change(Transition.TRANSITION_ACTIVATE)
        bench.arm.controller.power(Cb3RobotMode.RUNNING)
        bench.until(lambda: not bench.node.streaming.report.blocking_reason, "power")
        assert bench.change(Transition.TRANSITION_ACTIVATE)
        bench.swing()


def test_streamer_waits_for_a_controller_that_is_switched_on_later():
    with Bench(unreachable="connection refused") as bench:
        bench.until(lambda: bench.node.warning_counts.get("configure"), "an attempt")
        assert bench.node.status()[:2] == (WARN, "unconfigured")
        bench.arm.blocking_reason = ""
        bench.run(RETRY_PERIOD + 0.2)
        assert bench.streams()


def test_configure_reports_a_controller_that_refuses(capfd):
    with Bench(unreachable="RTDE: a test", autostart=False) as bench:
        begin = bench.time
        assert not bench.change(Transition.TRANSITION_CONFIGURE)
        assert bench.time - begin == pytest.approx(UrParameters().connect_timeout + 1.0, abs=0.1)
        assert bench.state == State.PRIMARY_STATE_UNCONFIGURED
        assert bench.arm.process.has_ended
    assert "not configured: no data from 127.0.0.1: RTDE: a test" in capfd.readouterr().err


def test_configure_reports_at_once_why_the_streaming_process_has_ended(capfd):
    with Bench(autostart=False) as bench:
        bench.arm.start_failure = "ur.reverse_port = 50001 is not available"
        begin = bench.time
        assert not bench.change(Transition.TRANSITION_CONFIGURE)
        assert bench.time - begin < 0.1
        assert bench.state == State.PRIMARY_STATE_UNCONFIGURED
    assert "ur.reverse_port = 50001 is not available" in capfd.readouterr().err


def test_stop_right_after_a_reset_is_sent_again():
    with Bench() as bench:
        bench.swing()
        bench.trigger("stop")
        bench.assert_stands("~/stop")
        assert bench.trigger("reset").success
        bench.trigger("stop")
        bench.assert_stands("~/stop")
        assert not bench.arm.plays()


def test_report_from_before_a_reset_does_not_latch_its_stop_again():
    with Bench() as bench:
        bench.swing()
        bench.trigger("stop")
        bench.assert_stands("~/stop")
        before = bench.node.streaming.report
        assert before.stop_reason == "~/stop"
        assert bench.trigger("reset").success
        bench.arm.process.add_report(before)
        bench.run(0.1)
        assert bench.node.latch.released


def test_emergency_stop_is_latched_and_prevents_a_reset_until_it_is_released():
    with Bench() as bench:
        emergency = bench.publisher(Bool, "emergency_stop", LATCHED)
        bench.swing()
        emergency.publish(Bool(data=True))
        bench.assert_stands("emergency_stop")
        assert not bench.arm.plays()
        answer = bench.trigger("reset")
        assert not answer.success
        assert "emergency_stop is true" in answer.message
        emergency.publish(Bool(data=False))
        bench.until(lambda: not bench.node.latch.emergency, "the release")
        bench.assert_stands("emergency_stop")
        bench.assert_goes_on()


def test_earlier_emergency_stop_keeps_the_streamer_inactive():
    with Bench(autostart=False) as bench:
        bench.publisher(Bool, "emergency_stop", LATCHED).publish(Bool(data=True))
        bench.until(lambda: bench.node.latch.emergency, "the emergency stop")
        assert bench.change(Transition.TRANSITION_CONFIGURE)
        assert not bench.change(Transition.TRANSITION_ACTIVATE)
        assert not bench.arm.controller.counts.programs


def test_stopped_peer_holds_the_arm_with_the_program_running():
    with Bench() as bench:
        peers = bench.publisher(DiagnosticStatus, "stop_state", LATCHED)
        bench.swing()
        peer = DiagnosticStatus(name="/probe", level=ERROR, message="stopped: test")
        peers.publish(peer)
        bench.until(bench.arm.rests, "rest")
        assert bench.stop_state.startswith("holding: stopped peer /probe")
        bench.run(0.1)
        place = bench.arm.place
        bench.move(0.6)
        assert np.abs(bench.arm.place - place).max() < STILL
        peer.level = OK
        peers.publish(peer)
        bench.until(lambda: bench.stop_state == "running", "the release")
        bench.run(0.2)
        assert np.abs(bench.arm.place - place).max() < STILL, "a release starts no motion"
        bench.swing()
        assert bench.arm.controller.counts.programs == 1


def test_protective_stop_is_reset_after_it_was_unlocked_on_the_pendant():
    with Bench() as bench:
        bench.swing()
        bench.arm.fault(protective_stop=True)
        bench.assert_stands("safety mode: protective stop")
        answer = bench.trigger("reset")
        assert not answer.success
        assert "ur.unlock" in answer.message
        bench.run(UNLOCK_DELAY)
        assert bench.arm.controller.unlock()
        bench.run(0.1)
        bench.assert_goes_on()


def test_emergency_stop_of_the_controller_is_latched_until_its_power_is_back():
    with Bench() as bench:
        bench.swing()
        bench.arm.fault(emergency_stop=True)
        bench.assert_stands("safety mode: robot emergency stop")
        assert "still present: safety mode" in bench.trigger("reset").message
        bench.arm.fault(emergency_stop=False)
        bench.run(0.1)
        assert bench.arm.controller.safety_mode is Cb3SafetyMode.NORMAL
        assert "still present: robot mode" in bench.trigger("reset").message
        assert bench.arm.controller.power(Cb3RobotMode.RUNNING)
        bench.until(lambda: not bench.node.streaming.report.blocking_reason, "power")
        bench.assert_goes_on()


@pytest.mark.parametrize(
    ("parameters", "name"),
    [
        ({"arm.joints": ["a", "b", "c"]}, "arm"),
        ({"arm.velocity": [4.0]}, "arm.velocity"),
        ({"arm.lower": [1.0], "arm.upper": [0.0]}, "arm.lower"),
        ({"ur.read_timeout": 0.5}, "ur.read_timeout"),
        ({"ur.register": 48}, "ur.register"),
    ],
)
def test_invalid_parameter_is_rejected_naming_the_parameter(parameters, name):
    with pytest.raises(ParameterError, match=name), Bench(**parameters):
        pass


def test_simulated_time_is_rejected_unless_the_controller_is_simulated():
    with pytest.raises(ParameterError, match="use_sim_time"), World(ArmStreamerNode):
        pass


def test_fixed_parameters_are_read_only_and_live_ones_change_at_runtime():
    with Bench() as bench:
        bench.swing()
        fixed, bad = bench.set(ur__read_timeout=0.1, arm__velocity=[-1.0])
        assert not fixed.successful and not bad.successful
        assert "arm.velocity" in bad.reason
        (live,) = bench.set(arm__velocity=[0.1])
        assert live.successful
        bench.assert_stands("velocity")


def test_granted_reset_replaces_a_streaming_process_that_hangs():
    with Bench() as bench:
        bench.swing()
        hanging = bench.arm.process
        hanging.is_frozen = True
        bench.move(HANG_TIMEOUT + 0.1)
        bench.assert_stands("the streaming process has not reported")
        bench.arm.blocking_reason = "connection refused"
        answer = bench.trigger("reset")
        assert "still present: connection refused" in answer.message
        assert bench.arm.process is not hanging
        bench.arm.blocking_reason = ""
        bench.run(0.1)
        bench.assert_goes_on()


def test_a_streaming_process_that_reports_again_is_kept():
    with Bench() as bench:
        bench.swing()
        process = bench.arm.process
        process.is_frozen = True
        bench.move(HANG_TIMEOUT + 0.1)
        bench.assert_stands("the streaming process has not reported")
        process.is_frozen = False
        bench.run(0.2)
        bench.assert_goes_on()
        assert bench.arm.process is process


def test_granted_reset_replaces_an_ended_streaming_process():
    with Bench() as bench:
        bench.swing()
        bench.arm.blocking_reason = "connection refused"
        bench.arm.process.kill()
        bench.assert_stands("the streaming process has ended")
        answer = bench.trigger("reset")
        assert "still present: connection refused" in answer.message
        bench.arm.blocking_reason = ""
        bench.run(0.1)
        bench.assert_goes_on()


def test_shutdown_brings_the_arm_to_rest_and_ends_the_program():
    with Bench() as bench:
        bench.swing()
        bench.node.begin_shutdown("SIGTERM")
        assert not bench.node.finished
        bench.run_until(lambda: bench.node.finished, bench.node.stop_timeout, "the end")
        bench.until(lambda: bench.arm.rests() and not bench.arm.plays(), "rest")


def test_the_arm_obeys_a_motion_limit_and_comes_to_rest_without_one():
    with Bench(**{"collision_monitor.use": True}) as bench:
        limits = bench.publisher(JointState, "motion_limit", 1)
        demands = bench.listen(JointState, "motion_demand")
        fraction = [1.0]

        def limit():
            if fraction:
                message = JointState(name=["platform", "arm"], velocity=[0.0, fraction[0]])
                message.header.stamp = bench.stamp()
                limits.publish(message)

        bench.hooks.append(limit)
        bench.swing()
        assert tuple(demands[-1].name) == UR_JOINTS
        assert max(map(abs, demands[-1].velocity)) > 0.1
        fraction.clear()  # the monitor has died
        bench.move(1.0)
        bench.run(1.0)  # the simulated arm swings out
        place = bench.arm.place
        bench.move(0.3)
        assert np.abs(bench.arm.place - place).max() < STILL
        assert bench.node.latch.released
        assert ("motion_limit", 0.0) in bench.node.status()[2]
        fraction.append(1.0)
        bench.run(0.1)
        bench.swing()
