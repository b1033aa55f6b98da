"""Topics and life cycle of the bridge, on stepped time, with simulated drives on a stepped bus.

Timing is tested on the policy (test/can_drives); a real bus and processes are tested
end to end (test/end_to_end/test_can_processes.py).
"""

from collections import deque

import can
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray, UInt32MultiArray
from std_srvs.srv import Trigger

from omniman_ros.can_drives.bus import BusError, CanBus
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.nodes.can_bridge import CanBridgeNode
from omniman_ros.nodes.hardware_node import MAX_RETRIES, RETRY_PERIOD
from omniman_ros.nodes.stop_interface import ALL_LATCHED, LATCHED
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.can_drives.network import SimulatedBus
from omniman_ros.simulation.can_drives.parameters import CanFaultParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from test.nodes.harness import World

PARAMETERS = {
    "can.nodes": [1, 2, 3, 4],
    "can.rate": 100.0,
    "can.direction": [1.0, -1.0, 1.0, -1.0],
}
NAMES = list(robot_parameters("omniman")["wheels.names"])
SHORTEST_WAIT = 1e-4
TIMEOUT = 10.0


class SteppedBus:
    """A bus between the bridge and simulated drives, on the time of a world.

    It has the interface of `CanBus`. The bridge waits for its drives inside a transition: waiting
    then advances the time of the world.
    """

    invalid = 0
    failure = ""

    def __init__(self):
        values = {k: tuple(v) if isinstance(v, list) else v for k, v in PARAMETERS.items()}
        plant = build(SimulationParameters, {"plant.lifted": True})
        robot = build(Platform, robot_parameters("omniman"))
        self.simulated = SimulatedBus(robot, plant, build(CanParameters, values, "can."))
        self.world = None
        self.is_on = True
        self.is_open = self.is_lost = self.is_unplugged = False
        self._wake = None
        self._inbox = deque()

    def open(self, parameters, wake):
        if self.is_unplugged:
            raise BusError("bus stepped cannot be opened: no such device")
        self.is_open, self.is_lost, self._wake = True, False, wake
        return self

    def unplug(self):
        """Take the interface away: what is open stays lost, even if the interface is back."""
        self.is_lost = self.is_unplugged = True

    def close(self):
        self.is_open = False
        self._inbox.clear()

    def advance(self):
        if self.is_on:
            self._deliver(self.simulated.advance(self.world.time))
        if self._inbox and self.is_open:
            self._wake()

    def take(self):
        while self._inbox:
            yield self._inbox.popleft()

    def wait(self, timeout):
        self.world.time += max(timeout, SHORTEST_WAIT)
        for node in [*self.world.nodes, self.world.probe]:
            self.world._set_time(node)
        if self.is_on:
            self._deliver(self.simulated.advance(self.world.time))

    def send(self, frames):
        if self.is_lost:
            return "frame not sent: no such device"
        for frame in frames:
            message = can.Message(
                arbitration_id=frame.id,
                data=frame.data,
                is_extended_id=frame.extended,
                is_remote_frame=frame.remote,
            )
            if self.is_on:
                self._deliver(self.simulated.receive(message, self.world.time))
        return ""

    def _deliver(self, messages):
        if self.is_open and not self.is_lost:
            self._inbox.extend(CanFrame(m.arbitration_id, bytes(m.data)) for m in messages)

    @property
    def speeds(self):
        return [self.simulated.wheels.velocity(k) for k in range(4)]

    @property
    def at_rest(self):
        return max(map(abs, self.speeds)) < 0.05


class Bench(World):
    """A bridge on a stepped bus with a probe that can command the bridge."""

    def __init__(self, **parameters):
        self.bus = SteppedBus()
        super().__init__(self._make, parameters=PARAMETERS | parameters)
        self.bus.world = self
        self.hooks.append(self.bus.advance)
        self.node = self.nodes[0]
        self._commands = None
        self.speed = None

    def _make(self, **options):
        return CanBridgeNode(open_bus=self.bus.open, **options)

    def send(self, speed, names=None, **fields):
        if self._commands is None:
            self._commands = self.publisher(JointState, "wheel_commands", 1)
        names = names or NAMES
        message = JointState(name=names, velocity=[speed] * len(names))
        for name, value in fields.items():
            setattr(message, name, value)
        self._commands.publish(message)

    def until(self, condition, what):
        return self.run_until(condition, TIMEOUT, f"{what}: {self.node.status()}")

    def until_driving(self):
        self.until(lambda: self.node.status()[1] == "driving", "driving")

    def until_warned(self):
        self.until(lambda: self.node._throttle.counts, "a warning")

    def drive(self, speed=3.0):
        """Bring all wheels to a speed and continue to command that speed."""
        self.speed = speed
        self.hooks.append(lambda: None if self.speed is None else self.send(self.speed))
        self.until(lambda: min(self.bus.speeds) > 0.9 * speed, "the speed")

    def change(self, transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.call(ChangeState, "can_bridge/change_state", request).success

    def trigger(self, name):
        return self.call(Trigger, f"can_bridge/{name}")

    @property
    def state(self):
        return self.call(GetState, "can_bridge/get_state").current_state.id

    def publish_emergency(self):
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.publisher(Bool, "emergency_stop", latched).publish(Bool(data=True))
        self.until(lambda: self.node.latch.emergency, "the emergency stop")


def test_the_bridge_starts_itself_drives_and_reports():
    with Bench() as bench:
        states = bench.listen(JointState, "wheel_states")
        electrical = bench.listen(Float64MultiArray, "wheel_electrical")
        bench.drive()
        assert states[-1].name == NAMES
        bench.until(lambda: min(states[-1].velocity) > 2.5, "feedback")
        bench.until(lambda: bool(electrical), "wheel_electrical")
        assert [d.size for d in electrical[-1].layout.dim] == [4, 3]
        level, message, values = bench.node.status()
        assert (level, message) == (b"\x00", "driving")
        assert ("front_left (node 1)", "enabled") in values
        bench.speed = 0.0
        bench.until(lambda: bench.bus.at_rest, "rest")


def test_the_bridge_retries_until_the_drives_are_switched_on():
    with Bench(**{"can.configure_timeout": 1.0}) as bench:
        bench.bus.is_on = False
        bench.run(0.5)
        assert bench.node.status()[1] == "unconfigured"
        bench.bus.is_on = True
        assert bench.run_until(
            lambda: bench.node.status()[1] == "driving", RETRY_PERIOD + 2.0, "driving"
        )


REFUSED = CanFaultParameters(refuse_enable=("rear_left",))
BRIEF = {"can.enable_timeout": 0.5}


def test_a_fault_while_the_bridge_starts_leads_to_another_attempt_and_to_no_stop():
    with Bench(**BRIEF) as bench:
        bench.bus.simulated.set_faults(REFUSED)
        states = bench.listen(DiagnosticStatus, "stop_state", ALL_LATCHED)
        bench.until(lambda: bench.node.warning_counts.get("activate"), "a failure")
        assert not bench.node.is_active
        assert bench.node.latch.released
        assert max(map(abs, bench.bus.speeds)) < 1e-3
        bench.bus.simulated.set_faults(CanFaultParameters())
        bench.until_driving()
        assert {state.message for state in states} == {"running"}


def test_an_emergency_message_between_two_transitions_of_the_start_is_no_stop(monkeypatch):
    with Bench() as bench:
        enable, faults = bench.node.enable_hardware, bench.bus.simulated.set_faults
        attempts = []

        def late_enable():
            attempts.append(bench.node.link.stop_reason)
            if len(attempts) == 1:
                faults(CanFaultParameters(fault=("front_left",)))
                # The message arrives before anything is enabled.
                bench.node.link.run_until(lambda: False, 0.2)
                faults(CanFaultParameters())
            return enable()

        monkeypatch.setattr(bench.node, "enable_hardware", late_enable)
        bench.until_driving()
        assert attempts == ["", ""]
        assert bench.node.warning_counts.get("activate") == 1
        assert bench.node.latch.released


def test_a_fault_that_stays_is_a_stop_after_some_attempts_and_a_reset_starts_again():
    with Bench(**BRIEF) as bench:
        bench.node._automatic_start.faults = MAX_RETRIES - 1  # the others take their time
        bench.bus.simulated.set_faults(REFUSED)
        bench.until(lambda: not bench.node.latch.released, "the stop")
        assert bench.node.latch.status.reason.startswith("not enabled: rear_left")
        assert bench.node.warning_counts["start"] == 1
        assert bench.node.warning_counts["activate"] == 2
        bench.bus.simulated.set_faults(CanFaultParameters())
        bench.run(3 * RETRY_PERIOD)
        assert not bench.node.is_active
        assert bench.trigger("reset").success
        bench.until_driving()


def silence_drives(bench, seconds=0.5):
    """Let the bridge hear no drive for a while, as on a machine that has no time for them."""
    bench.bus.is_on = False
    bench.run(seconds)
    bench.bus.is_on = True


def test_drives_that_fall_silent_before_any_motion_are_started_again():
    with Bench() as bench:
        states = bench.listen(DiagnosticStatus, "stop_state", ALL_LATCHED)
        bench.until_driving()
        bench.send(0.0)
        silence_drives(bench)
        assert bench.node.warning_counts.get("start") == 1
        assert not bench.node.is_active
        bench.until_driving()
        assert bench.node.is_active
        assert {state.message for state in states} == {"running"}
        bench.drive()


@pytest.mark.parametrize("effort", [[], [0.01] * 4])
def test_drives_that_may_have_moved_are_not_started_again(effort):
    with Bench() as bench:
        bench.until_driving()
        bench.send(0.0 if effort else 0.1, effort=effort)
        bench.until(lambda: bench.node.link.drives.may_have_moved, "the command")
        silence_drives(bench)
        assert "start" not in bench.node.warning_counts
        assert "no feedback" in bench.node.latch.status.reason
        bench.run(RETRY_PERIOD + 0.2)
        assert "start" not in bench.node.warning_counts
        assert not bench.node.latch.released


def test_faults_before_any_motion_that_go_on_are_a_stop_in_the_end():
    with Bench() as bench:
        bench.node._automatic_start.faults = MAX_RETRIES - 1  # the others take their time
        bench.until_driving()
        silence_drives(bench)
        assert bench.node.latch.released
        bench.until_driving()
        silence_drives(bench)
        assert "no feedback" in bench.node.latch.status.reason
        assert bench.node.warning_counts["start"] == 1
        assert bench.trigger("reset").success
        bench.until_driving()


def test_a_stop_before_any_motion_is_no_fault():
    with Bench() as bench:
        bench.until_driving()
        assert bench.trigger("stop").success
        bench.run(2 * RETRY_PERIOD)
        assert "start" not in bench.node.warning_counts
        assert bench.node.latch.status.reason == "~/stop"
        assert bench.node.is_active


def test_a_stop_while_the_bridge_starts_stays_until_a_reset():
    with Bench(**BRIEF) as bench:
        bench.bus.simulated.set_faults(REFUSED)
        bench.until(lambda: bench.node.warning_counts.get("activate"), "a failure")
        assert bench.trigger("stop").success
        bench.bus.simulated.set_faults(CanFaultParameters())
        bench.run(3 * RETRY_PERIOD)
        assert not bench.node.is_active
        assert bench.node.latch.status.reason == "~/stop"
        assert bench.trigger("reset").success
        bench.until_driving()


def test_the_life_cycle_opens_enables_disables_and_closes():
    with Bench(autostart=False) as bench:
        assert bench.state == State.PRIMARY_STATE_UNCONFIGURED
        assert bench.node.link is None
        assert bench.change(Transition.TRANSITION_CONFIGURE)
        assert bench.node.link.drives.phase.value == "idle"
        bench.send(3.0)
        bench.until_warned()
        assert bench.change(Transition.TRANSITION_ACTIVATE)
        assert bench.state == State.PRIMARY_STATE_ACTIVE
        bench.drive()
        bench.speed = None
        assert bench.change(Transition.TRANSITION_DEACTIVATE)
        bench.until(lambda: bench.bus.at_rest, "rest")
        assert bench.node.link.drives.is_off
        assert bench.change(Transition.TRANSITION_CLEANUP)
        assert bench.node.link is None
        assert bench.state == State.PRIMARY_STATE_UNCONFIGURED


def test_an_interface_that_went_away_comes_back_with_a_reset():
    with Bench() as bench:
        bench.drive()
        bench.bus.unplug()
        bench.until(lambda: not bench.node.latch.released, "the stop")
        assert bench.node.latch.status.reason.startswith("bus: ")
        bench.until(lambda: bench.bus.at_rest, "rest")
        bench.run(bench.node.link.stop_timeout)  # the drives are silent: the stop has to be over
        refused = bench.trigger("reset")
        assert not refused.success
        assert "no such device" in refused.message
        assert not bench.node.latch.released
        bench.bus.is_unplugged = False
        assert bench.trigger("reset").success
        bench.until_driving()
        bench.until(lambda: min(bench.bus.speeds) > 2.0, "the speed")


def test_a_reset_in_motion_is_refused():
    with Bench() as bench:
        bench.drive()
        assert bench.trigger("stop").success
        refused = bench.trigger("reset")
        assert min(bench.bus.speeds) > 1.0
        assert not refused.success and not bench.node.latch.released
        bench.until(lambda: bench.bus.at_rest, "rest")


def test_invalid_transition_is_refused_and_driving_continues():
    with Bench() as bench:
        bench.drive()
        for refused, transition in enumerate(
            (
                Transition.TRANSITION_CONFIGURE,
                Transition.TRANSITION_ACTIVATE,
                Transition.TRANSITION_CLEANUP,
                Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
                200,
            )
        ):
            assert not bench.change(transition)
            assert bench.node._throttle.counts["transition"] == refused + 1
            assert bench.state == State.PRIMARY_STATE_ACTIVE
            bench.run(0.1)
            assert min(bench.bus.speeds) > 2.0


@pytest.mark.parametrize("is_shut_down", [False, True])
def test_node_taken_down_by_hand_is_not_restarted(is_shut_down):
    with Bench() as bench:
        bench.until_driving()
        assert bench.change(Transition.TRANSITION_DEACTIVATE)
        assert not bench.node.is_starting
        if is_shut_down:
            assert bench.change(Transition.TRANSITION_INACTIVE_SHUTDOWN)
        bench.run(2.0 * RETRY_PERIOD)
        shut_down, inactive = State.PRIMARY_STATE_FINALIZED, State.PRIMARY_STATE_INACTIVE
        assert bench.state == (shut_down if is_shut_down else inactive)


def test_node_shut_down_before_its_start_stays_so():
    with Bench(**{"can.configure_timeout": 0.5}) as bench:
        bench.bus.is_on = False
        bench.until(lambda: bench.node.warning_counts.get("configure"), "a failure")
        bench.bus.is_on = True
        assert bench.change(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
        bench.run(2.0 * RETRY_PERIOD)
        assert bench.state == State.PRIMARY_STATE_FINALIZED


def test_exception_in_a_transition_is_logged_and_closes_the_bus(capfd):
    with Bench(autostart=False) as bench:
        assert bench.change(Transition.TRANSITION_CONFIGURE)
        bench.node.link.enable = lambda: 1 / 0
        assert not bench.change(Transition.TRANSITION_ACTIVATE)
        assert bench.node.link is None
        assert not bench.bus.is_open
        assert bench.state == State.PRIMARY_STATE_UNCONFIGURED
    assert "on_activate failed" in (log := capfd.readouterr().err)
    assert "ZeroDivisionError" in log


def test_drives_that_cannot_be_enabled_stay_off_and_the_node_inactive():
    with Bench(autostart=False, **{"can.enable_timeout": 0.5}) as bench:
        assert bench.change(Transition.TRANSITION_CONFIGURE)
        bench.bus.simulated.set_faults(CanFaultParameters(refuse_enable=("rear_left",)))
        assert not bench.change(Transition.TRANSITION_ACTIVATE)
        assert bench.state == State.PRIMARY_STATE_INACTIVE
        assert bench.node.link.drives.is_off
        assert not bench.change(Transition.TRANSITION_ACTIVATE), "a stopped node is refused"


def test_emergency_stop_before_the_start_keeps_the_drives_off():
    with Bench(autostart=False) as bench:
        bench.publish_emergency()
        assert bench.change(Transition.TRANSITION_CONFIGURE)
        assert not bench.change(Transition.TRANSITION_ACTIVATE)
        assert bench.node.link.drives.is_off


def test_fault_stops_all_wheels_and_appears_in_the_diagnostics():
    with Bench() as bench:
        bench.drive()
        bench.bus.simulated.set_faults(CanFaultParameters(fault=("rear_left",)))
        bench.until(lambda: not bench.node.latch.released, "the stop")
        level, message, _ = bench.node.status()
        assert level == b"\x02"
        assert message.startswith("rear_left: EMCY 2310")
        bench.until(lambda: bench.bus.at_rest, "rest")


def test_a_drive_that_boots_is_told_by_its_number_of_restarts():
    with Bench() as bench:
        counts = bench.listen(UInt32MultiArray, "wheel_restarts", LATCHED)
        bench.drive()
        before = list(counts[-1].data)
        bench.bus.simulated.set_faults(CanFaultParameters(reboot=("front_right",)))
        bench.until(lambda: not bench.node.latch.released, "the stop")
        bench.run(0.02)
        assert len(before) == 4
        assert (np.array(counts[-1].data) - before).tolist() == [0, 1, 0, 0]


def test_stale_command_causes_a_warning_and_no_motion():
    with Bench() as bench:
        bench.until_driving()
        message = JointState()
        message.header.stamp = bench.stamp(-2.0 * CanParameters(nodes=(1,)).command_timeout)
        bench.run(0.1, lambda: bench.send(3.0, header=message.header))
        bench.until_warned()
        assert list(bench.node._throttle.counts) == ["wheel_commands"]
        assert bench.bus.at_rest


def test_bus_that_cannot_be_opened_causes_a_warning_and_the_node_keeps_running():
    def make(**options):
        return CanBridgeNode(open_bus=CanBus, **options)

    with World(make, parameters=PARAMETERS | {"can.interface": "no_such_interface"}) as world:
        node = world.nodes[0]
        world.run_until(lambda: node._throttle.counts, TIMEOUT, "a warning")
        assert node.status()[1] == "unconfigured"


@pytest.mark.parametrize(
    ("parameters", "name"),
    [
        ({"can.nodes": [1, 2, 3]}, "can.nodes"),
        ({"can.direction": [2.0]}, "can.direction"),
        ({"can.protocol": "modbus"}, "can.protocol"),
    ],
)
def test_invalid_installation_is_rejected_naming_the_parameter(parameters, name):
    with pytest.raises(ParameterError, match=name), Bench(**parameters):
        pass


def test_simulated_time_is_rejected():
    with (
        pytest.raises(ParameterError, match="use_sim_time"),
        World(CanBridgeNode, parameters=PARAMETERS),
    ):
        pass


def test_limits_change_while_driving_and_the_installation_does_not():
    with Bench() as bench:
        bench.until_driving()
        fixed, live = bench.node.set_parameters(
            [Parameter("can.rate", value=50.0), Parameter("can.max_speed", value=1.0)]
        )
        assert not fixed.successful
        assert live.successful
        bench.send(3.0)
        bench.until_warned()
        assert bench.bus.at_rest


def test_shutdown_stops_the_wheels_and_switches_the_power_off():
    with Bench() as bench:
        bench.drive()
        bench.speed = None
        bench.node.begin_shutdown("SIGTERM")
        assert not bench.node.finished
        bench.run_until(lambda: bench.node.finished, bench.node.stop_timeout, "the end")
        assert bench.bus.at_rest
