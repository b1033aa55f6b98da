"""The ODrive axis against an independent drive: the mock of the package odrive-can."""

import asyncio
import gc
import math
import threading
import time
import weakref

import can
import pytest

from omniman_ros.can_drives.axis import REST, AxisState, Demand, DriveSetpoint, Receipt
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.can_drives.odrive import OdriveAxis
from omniman_ros.control.wheel_cascade import DriveMode
from test.can_drives.fuzz import settings

mock = pytest.importorskip("odrive_can.mock", reason="the package odrive-can is not installed")
pytestmark = pytest.mark.processes

NODE = 5
PERIOD = 0.02
PATIENCE = 30.0
TURN = math.tau
SPEED = DriveSetpoint(DriveMode.VELOCITY, 2.0 * TURN)


class Drive:
    """The mock, in a thread and a loop of its own."""

    def __init__(self, channel):
        self._mock = mock.ODriveCANMock(NODE, can.Bus(channel, interface="virtual"))
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="odrive mock", daemon=True)
        self._thread.start()

    def _run(self):
        asyncio.set_event_loop(self._loop)
        self._task = self._loop.create_task(self._mock.main())
        try:
            self._loop.run_until_complete(self._task)
        except asyncio.CancelledError:
            pass
        finally:
            self._loop.close()

    @property
    def axis_state(self):
        return str(self._mock.odrive.axis_state)

    @property
    def control_mode(self):
        return str(self._mock.odrive.control_mode)

    def close(self):
        """End its tasks, then let its `__del__` stop its reader and its bus."""
        if self._mock is None:
            return
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._task.cancel)
            self._thread.join(PATIENCE)
        assert not self._thread.is_alive()
        gone = weakref.ref(self._mock)
        self._mock = self._task = None
        gc.collect()
        assert gone() is None


class Host:
    """The ODrive axis on the same bus, ticked in real time."""

    def __init__(self, channel):
        self._bus = can.Bus(channel, interface="virtual")
        self.axis = OdriveAxis(
            settings(
                node=NODE, period=PERIOD, drive_heartbeat=0.4, feedback_timeout=0.5, max_speed=50.0
            )
        )
        self.refused = []

    def run(self, demand, setpoint, until):
        """Tick until something is so; fail when it takes too long."""
        end = time.monotonic() + PATIENCE
        while not until():
            now = time.monotonic()
            assert now < end, (self.axis.state, self.axis.fault_reason, self.axis.feedback)
            while (message := self._bus.recv(0.0)) is not None:
                frame = CanFrame(
                    message.arbitration_id, bytes(message.data), message.is_extended_id
                )
                if self.axis.receive(frame, now) is not Receipt.ACCEPTED:
                    self.refused.append(frame)
            for frame in self.axis.tick(demand, setpoint, now):
                self._bus.send(
                    can.Message(
                        arbitration_id=frame.id,
                        data=frame.data or None,
                        is_extended_id=False,
                        is_remote_frame=frame.remote,
                    )
                )
            time.sleep(PERIOD)

    def close(self):
        self._bus.shutdown()


@pytest.fixture
def pair(request):
    channel = f"odrive {request.node.name}"
    drive, host = Drive(channel), Host(channel)
    yield drive, host
    drive.close()
    host.close()


def test_mock_is_configured_enabled_driven_stopped_and_released(pair):
    drive, host = pair
    axis, feedback = host.axis, host.axis.feedback
    axis.configure(time.monotonic())
    host.run(Demand.IDLE, REST, lambda: axis.state is AxisState.READY)
    assert drive.axis_state == "IDLE" and drive.control_mode == "VELOCITY_CONTROL"

    host.run(Demand.DRIVE, SPEED, lambda: axis.state is AxisState.ENABLED)
    assert drive.axis_state == "CLOSED_LOOP_CONTROL"
    assert feedback.velocity == feedback.position == 0.0

    host.run(Demand.DRIVE, SPEED, lambda: feedback.velocity == pytest.approx(2.0 * TURN))
    start, began, count = feedback.position, feedback.at, feedback.count
    host.run(Demand.DRIVE, SPEED, lambda: feedback.count >= count + 20)
    speed = (feedback.position - start) / (feedback.at - began)
    assert speed == pytest.approx(2.0 * TURN, rel=0.3)

    back = DriveSetpoint(DriveMode.VELOCITY, -1.0 * TURN)
    host.run(Demand.STOP, back, lambda: feedback.velocity == pytest.approx(-1.0 * TURN))
    host.run(Demand.STOP, REST, lambda: feedback.velocity == 0.0)
    host.run(Demand.IDLE, REST, lambda: axis.state is AxisState.READY)
    assert drive.axis_state == "IDLE"
    assert not axis.fault_reason and not host.refused


def test_mock_gets_another_mode_and_answers_requests(pair):
    drive, host = pair
    axis, feedback = host.axis, host.axis.feedback
    axis.configure(time.monotonic())
    host.run(Demand.IDLE, REST, lambda: axis.state is AxisState.READY)
    host.run(Demand.DRIVE, REST, lambda: axis.state is AxisState.ENABLED)
    torque = DriveSetpoint(DriveMode.TORQUE, 0.1)
    host.run(Demand.DRIVE, torque, lambda: drive.control_mode == "TORQUE_CONTROL")
    host.run(Demand.STOP, REST, lambda: drive.control_mode == "VELOCITY_CONTROL")
    host.run(Demand.STOP, REST, lambda: feedback.current == feedback.bus_voltage == 0.0)
    assert not axis.fault_reason and not host.refused


def test_mock_that_falls_silent_is_a_missing_heartbeat(pair):
    drive, host = pair
    axis = host.axis
    axis.configure(time.monotonic())
    host.run(Demand.IDLE, REST, lambda: axis.state is AxisState.READY)
    drive.close()
    host.run(Demand.IDLE, REST, lambda: axis.fault_reason)
    assert "heartbeat" in axis.fault_reason
