"""Gaps in the stream: the program on a simulated controller, on time that the test gives."""

import socket

import numpy as np
import pytest

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.simulation.ur.arm import CYCLE, UrArmParameters
from omniman_ros.simulation.ur.controller_server import ControllerServer
from omniman_ros.simulation.ur.modes import Cb3RuntimeState, Cb3SafetyMode
from omniman_ros.simulation.ur.port_parameters import UrPortParameters
from omniman_ros.ur.joint_preview import JointPreview
from omniman_ros.ur.parameters import UrParameters
from omniman_ros.ur.reverse_interface import ProgramMode, pack
from omniman_ros.ur.servo_program import servo_program
from omniman_ros.ur.streaming_messages import StreamingPhase
from omniman_ros.ur.streaming_supervisor import StreamingSupervisor, joint_limits
from test.tiers import combinations
from test.ur.stepped_link import SteppedLink

T0 = 100.0
HOME = (0.0, -1.5, 1.0, 0.0, 0.5, 0.0)
READ_TIMEOUT = 0.2
ARM = ArmParameters()
FASTEST, HARDEST = ARM.velocity[0], ARM.acceleration[0]
"""Limits of speed [rad/s] and acceleration [rad/s^2] of each joint."""
OMEGA = HARDEST / FASTEST
#: Angular frequency [rad/s] and amplitude [rad] of a swing close to both limits
AMPLITUDE = 0.85 * FASTEST / OMEGA
SWELLING_TIME = 3.0  #: Time after which the swing has its full amplitude [s]
SPEED = 2.0  #: Speed of the motion during which the controller is held up [rad/s]


class World(SteppedLink):
    """Supervisor and controller in step; the supervisor alone can be held up.

    Args:
        fraction: Share of the limits of speed and acceleration that a swing uses, over 0.85.
    """

    def __init__(self, fraction=1.0):
        self.amplitude = fraction * AMPLITUDE
        super().__init__(T0, initial=HOME)
        parameters = UrParameters(read_timeout=READ_TIMEOUT, feedback_timeout=0.5)
        self.streamer = StreamingSupervisor(self, ARM, parameters)
        self.due, self.begin = T0, 0.0
        self.speeds = []
        self.cycle_controller()
        self.streamer.start(self.now)
        while self.streamer.phase is not StreamingPhase.STREAMING:
            self.cycle()
        self.due = self.begin = self.now

    def cycle_controller(self):
        super().cycle_controller()
        self.speeds.append(self.controller.arm.qd.copy())

    def cycle(self, missed=0):
        """Run cycles of the controller, and then those of the supervisor that are due."""
        for _ in range(1 + missed):
            self.cycle_controller()
        for _ in range(1 + missed):
            self.due += CYCLE
            self.streamer.check([self.sample], self.now)
            self.streamer.tick(self.due, self.now)

    def swing(self, seconds, missed_at=None, missed=0):
        """Swing all joints, with previews of 0.4 s every 40 ms, and miss periods at a cycle."""
        for k in range(round(seconds / CYCLE)):
            if k % 5 == 0:
                times = self.now + 0.02 * np.arange(21)
                self.streamer.follow(JointPreview(times, *self.motion(times)), self.now)
            self.cycle(missed if k == missed_at else 0)

    def motion(self, times):
        """Return angles [rad] and velocities [rad/s] (m, 6) of a swing that swells from rest."""
        t = np.maximum(times - self.begin, 0.0)[:, None]
        u = np.minimum(t / SWELLING_TIME, 1.0)
        swell = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        swell_rate = 30.0 * u**2 * (1.0 - u) ** 2 / SWELLING_TIME
        sine, cosine = np.sin(OMEGA * t), np.cos(OMEGA * t)
        return (
            np.array(HOME) + self.amplitude * swell * sine * np.ones(6),
            self.amplitude * (swell_rate * sine + OMEGA * swell * cosine) * np.ones(6),
        )


def accelerations(world):
    return np.diff(np.array(world.speeds), axis=0) / CYCLE


BEGINS = (3.1, 4.1, 3.6, 4.6)  #: Times of the swing at which a gap begins [s]


@pytest.mark.parametrize(("missed", "begin"), combinations([1, 8, 2, 4], BEGINS))
def test_arm_keeps_its_limits_when_it_catches_up_after_a_gap(missed, begin):
    world = World()
    world.swing(6.0, missed_at=round(begin / CYCLE), missed=missed)
    assert not world.streamer.stop_reason
    assert world.controller.runtime == Cb3RuntimeState.PLAYING
    assert np.abs(world.speeds).max() < FASTEST
    assert np.abs(accelerations(world)).max() < HARDEST


@pytest.mark.parametrize(("gap", "begin"), combinations([(12, 0.6), (23, 0.4)], BEGINS))
def test_arm_goes_on_within_its_limits_after_a_long_gap(gap, begin):
    missed, fraction = gap
    world = World(fraction)
    world.swing(6.0, missed_at=round(begin / CYCLE), missed=missed)
    assert not world.streamer.stop_reason
    assert not world.streamer.take_refusals()
    assert world.controller.runtime == Cb3RuntimeState.PLAYING
    assert np.abs(world.speeds).max() < FASTEST
    assert np.abs(accelerations(world)).max() < HARDEST


@pytest.mark.parametrize(("missed", "begin"), combinations([16, 23], BEGINS))
def test_arm_that_cannot_catch_up_after_a_long_gap_comes_to_rest_without_a_stop(missed, begin):
    world = World()
    world.swing(6.0, missed_at=round(begin / CYCLE), missed=missed)
    assert world.controller.safety_mode == Cb3SafetyMode.NORMAL
    assert world.controller.runtime == Cb3RuntimeState.PLAYING
    assert np.abs(world.speeds).max() < FASTEST
    assert np.abs(accelerations(world)).max() < HARDEST
    assert not world.streamer.stop_reason
    if world.streamer.take_refusals():
        assert world.streamer.at_rest


def test_arm_keeps_its_limits_when_setpoints_arrive_a_cycle_later_and_earlier_again():
    world = World()
    world.swing(3.9)
    assert np.abs(world.speeds[-1]).min() > 0.8 * FASTEST
    world.cycle_controller()
    world.swing(0.8)
    world.due += CYCLE
    world.streamer.tick(world.due, world.now)
    world.swing(0.8)
    assert not world.streamer.stop_reason
    assert not world.streamer.take_refusals()
    assert np.abs(world.speeds).max() < FASTEST
    assert np.abs(accelerations(world)).max() < HARDEST
    arm, reference = world.controller.arm, world.motion(np.array([world.now]))[0][0]
    assert arm.q == pytest.approx(reference, abs=0.02)


@pytest.mark.parametrize("missed", [4, 20, 70])
def test_simulated_controller_that_was_held_up_moves_the_arm_evenly(missed):
    ports = UrPortParameters(dashboard=0, primary=0, secondary=0, realtime=0, rtde=0)
    server = ControllerServer(UrArmParameters(), ports)
    arm, speeds = server.controller.arm, []
    now, place = T0, arm.q.copy()

    def cycle(due_cycles=1):
        nonlocal now
        now += CYCLE
        server.cycle(now, due_cycles)
        speeds.append(arm.qd.copy())

    with socket.create_server(("127.0.0.1", 0)) as listener:
        limits = joint_limits(ARM, UrParameters())
        text = servo_program(UrParameters(), limits, *listener.getsockname())
        assert server.controller.start(text)
        cycle()
        program, _ = listener.accept()
    with program:
        program.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

        def send(count, speed=SPEED):
            nonlocal place
            data = b""
            for _ in range(count):
                place = place + speed * CYCLE
                data += pack(place.tolist(), ProgramMode.SERVO, READ_TIMEOUT)
            program.sendall(data)  # at once: nothing waits for an acknowledgement

        for speed in [*np.linspace(0.0, SPEED, 80), *[SPEED] * 40]:
            send(1, speed)
            cycle()
        send(1 + missed)
        for k in range(missed, -1, -1):
            cycle(1 + k)
        for _ in range(10):
            send(1)
            cycle()
    assert server.controller.safety_mode == Cb3SafetyMode.NORMAL
    assert np.array(speeds[120:]) == pytest.approx(SPEED, abs=0.1)
    assert arm.q == pytest.approx(place, abs=0.15)
    server.close()
