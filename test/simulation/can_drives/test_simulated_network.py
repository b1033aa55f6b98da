"""The simulated drives of an installation: on one bus, on one plant."""

import math
import struct
from dataclasses import replace

import can
import numpy as np
import pytest

from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.simulation.can_drives.motor import DriveFaults
from omniman_ros.simulation.can_drives.network import EchoFilter, SimulatedBus
from omniman_ros.simulation.can_drives.parameters import (
    FAULT_FLAGS,
    CanFaultParameters,
    drive_faults,
)
from omniman_ros.simulation.plant.drive_unit import DriveUnitMode
from test.simulation.plant.support import parameters, robot

TURN = 2 * math.pi
NAMES = ("front_left", "front_right", "rear_left", "rear_right")
NODES = [1, 2, 3, 4]
COUNTS = 4096
SPEED = struct.Struct("<Hi")


def installation(**changes):
    values = {"nodes": NODES, "counts": COUNTS, "gear_ratio": 0.0, **changes}
    return build(CanParameters, values)


def faults(**changes):
    return build(CanFaultParameters, changes)


class Host:
    """Minimal host: maps PDOs, enables, sends setpoints and SYNC, without policy."""

    def __init__(self, name="omniman", changes=None, seed=0, directions=(1.0,), **settings):
        self.robot = robot(name)
        self.installation = installation(direction=list(directions), **(changes or {}))
        self.bus = SimulatedBus(self.robot, parameters(**settings), self.installation, seed=seed)
        self.now, self.got = 5.0, []
        self.wait(0.05)

    def wait(self, seconds, period=0.001):
        for _ in range(round(seconds / period)):
            self.now += period
            self.got += self.bus.advance(self.now)

    def send(self, can_id, data):
        message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
        answer = self.bus.receive(message, self.now)
        self.got += answer
        return answer

    def write(self, node, index, sub, value, size):
        request = struct.pack("<BHB", 0x23 | (4 - size) << 2, index, sub)
        data = value.to_bytes(size, "little").ljust(4, b"\0")
        answers = [
            f for f in self.send(0x600 + node, request + data) if f.arbitration_id == 0x580 + node
        ]
        assert [answer.data[0] for answer in answers] == [0x60]

    def configure(self, mode=9, watch=100):
        for node in NODES:
            for base, entries in (
                (0x1400, (0x6040_0010, 0x60FF_0020)),
                (0x1800, (0x6041_0010, 0x6077_0010)),
                (0x1801, (0x6064_0020, 0x606C_0020)),
            ):
                cob = {0x1400: 0x200, 0x1800: 0x180, 0x1801: 0x280}[base] + node
                self.write(node, base, 1, 0x8000_0000 | cob, 4)
                self.write(node, base + 0x200, 0, 0, 1)
                for sub, entry in enumerate(entries, 1):
                    self.write(node, base + 0x200, sub, entry, 4)
                self.write(node, base + 0x200, 0, len(entries), 1)
                self.write(node, base, 2, 1, 1)
                self.write(node, base, 1, cob, 4)
            self.write(node, 0x6007, 0, 3, 2)
            self.write(node, 0x1016, 1, 127 << 16 | watch, 4)
            self.write(node, 0x6060, 0, mode, 1)
        self.send(0, bytes([1, 0]))
        for word in (6, 7, 15):
            self.tick(word, [0.0] * 4)

    def tick(self, word, speeds, wait=0.005):
        """One period: heartbeat, setpoints in rad/s at the wheels, SYNC."""
        self.send(0x77F, b"\x05")
        gear = self.robot.motor.gear_ratio
        directions = self.installation.directions(4)
        for node, speed, sign in zip(NODES, speeds, directions, strict=True):
            self.send(0x200 + node, SPEED.pack(word, round(sign * speed * gear * COUNTS / TURN)))
        self.got.clear()
        self.send(0x80, b"")
        self.wait(wait)

    def drive(self, seconds, speeds):
        for _ in range(round(seconds / 0.005)):
            self.tick(15, speeds)

    def speeds(self):
        return np.array([wheel.speed for wheel in self.bus.wheels.plant.wheels])


# driving


def test_all_drives_boot_up_and_nothing_moves():
    host = Host()
    assert [(f.arbitration_id, bytes(f.data)) for f in host.got] == [
        (0x700 + node, b"\x00") for node in NODES
    ]
    host.wait(0.5)
    assert not host.speeds().any()
    assert not host.bus.wheels.electrical()[:, 1].any()


@pytest.mark.parametrize("directions", [(1.0,), (1.0, -1.0, 1.0, -1.0)])
def test_setpoints_on_the_bus_move_the_plant_and_come_back(directions):
    host = Host(directions=directions)
    host.configure()
    host.drive(1.5, [3.0] * 4)
    np.testing.assert_allclose(host.speeds(), 3.0, rtol=0.03)
    pose, twist = host.bus.ground_truth()
    assert pose[0] > 0.3 and abs(pose[1]) < 0.01
    assert twist[0] == pytest.approx(3.0 * 0.127, rel=0.05)
    gear, signs = host.robot.motor.gear_ratio, host.installation.directions(4)
    for k, node in enumerate(NODES):
        (report,) = [f for f in host.got if f.arbitration_id == 0x280 + node]
        count, speed = struct.unpack("<ii", report.data)
        units = signs[k] * COUNTS * gear / TURN
        assert count == pytest.approx(units * host.bus.wheels.position(k), abs=0.1 * abs(units))
        assert speed == pytest.approx(3.0 * units, rel=0.05)


@pytest.mark.parametrize("name", ["omniman", "ig42"])
def test_drives_bring_the_wheels_to_rest_by_themselves_when_the_host_falls_silent(name):
    host = Host(name)
    host.configure()
    host.drive(1.2, [4.0] * 4)
    fastest = np.abs(host.speeds()).max()
    assert fastest > 3.8
    # the latest heartbeat was 5 ms ago: 100 ms without one, then 9 rad/s^2
    host.wait(0.094)
    assert host.speeds().min() > 3.5
    host.wait(0.002 + fastest / 9.0 + 0.15)
    assert np.abs(host.speeds()).max() < 0.1
    codes = {bytes(f.data)[:2] for f in host.got if 0x80 < f.arbitration_id < 0x100}
    assert codes == {b"\x30\x81"}
    host.wait(1.0)
    assert not host.bus.wheels.electrical()[:, 1].any()
    # whatever the host then wants
    host.drive(0.3, [4.0] * 4)
    assert np.abs(host.speeds()).max() < 0.05


def test_wheel_whose_encoder_freezes_is_reported_as_a_fault():
    host = Host("ig42")
    host.configure()
    host.drive(1.0, [3.0] * 4)
    frozen = parameters(faults__frozen_encoder=["front_right"])
    host.bus.configure(host.robot, frozen, faults())
    seen = []
    for _ in range(200):
        host.tick(15, [6.0] * 4)
        seen += [(f.arbitration_id, bytes(f.data)[:2]) for f in host.got]
    assert (0x082, b"\x05\x73") in seen
    assert not any(can_id in (0x081, 0x083, 0x084) for can_id, _ in seen)


def test_long_gap_is_run_through_with_the_drives_own_watchdogs():
    host = Host()
    host.configure()
    host.drive(1.0, [4.0] * 4)
    host.now += 3600.0
    before, (start, _) = host.bus.wheels.steps, host.bus.ground_truth()
    host.bus.advance(host.now)
    assert host.bus.wheels.steps - before < 6000
    assert np.abs(host.speeds()).max() < 0.1
    # 0.1 s until the heartbeat is missed, and the ramp from 4 rad/s at 9 rad/s^2
    travel = host.bus.ground_truth()[0][0] - start[0]
    assert travel == pytest.approx(0.127 * (4.0 * 0.1 + 4.0**2 / 18.0), rel=0.1)
    host.wait(0.01)
    assert host.bus.wheels.steps - before < 6100


def test_robot_can_be_relocated():
    host = Host()
    host.bus.set_pose([1.0, 2.0, 0.5])
    np.testing.assert_allclose(host.bus.ground_truth()[0], [1.0, 2.0, 0.5])
    with pytest.raises(InputError):
        host.bus.set_pose([1.0, 2.0])
    with pytest.raises(InputError):
        host.bus.advance(math.nan)


# the end


def test_halt_ramps_all_wheels_together_and_nothing_is_received_or_sent_any_more():
    host = Host()
    host.configure()
    host.drive(1.5, [4.0, 2.0, 2.0, 4.0])
    start = host.speeds()
    host.bus.halt()
    host.got.clear()
    half = np.abs(start).max() / 9.0 / 2
    for _ in range(round(half / 0.005)):
        host.tick(15, [4.0] * 4)
    np.testing.assert_allclose(host.speeds(), start / 2, atol=0.4)
    assert not host.bus.at_rest
    host.wait(half + 0.4)
    assert host.bus.at_rest and np.abs(host.speeds()).max() < 0.05
    assert host.got == []
    host.bus.release()
    host.wait(0.1)
    assert not host.bus.wheels.electrical()[:, 1].any()


# faults


@pytest.mark.parametrize("name", FAULT_FLAGS)
def test_each_fault_is_of_the_wheels_that_are_named(name):
    host = Host()
    host.bus.set_faults(faults(**{name: ["front_right", "rear_left"]}))
    assert [getattr(fault, name) for fault in host.bus.faults] == [False, True, True, False]
    others = [other for other in FAULT_FLAGS if other != name]
    assert not any(getattr(fault, other) for fault in host.bus.faults for other in others)
    host.bus.set_faults(faults())
    assert host.bus.faults == (DriveFaults(),) * 4


def test_supply_is_one_for_all():
    host = Host()
    host.bus.set_faults(faults(supply=5.0))
    host.wait(0.01)
    assert {f.arbitration_id for f in host.got if bytes(f.data)[:2] == b"\x20\x32"} == {
        0x80 + node for node in NODES
    }


def test_drive_restarts_when_its_name_appears_and_not_again_while_it_stays():
    host = Host()
    host.got.clear()

    def boots():
        host.wait(0.05)
        seen = [f.arbitration_id for f in host.got if f.arbitration_id > 0x700]
        host.got.clear()
        return seen

    host.bus.set_faults(faults(reboot=["rear_left"]))
    assert boots() == [0x703]
    host.bus.set_faults(faults(reboot=["rear_left", "front_left"], supply=40.0))
    assert boots() == [0x701]
    host.bus.set_faults(faults())
    assert boots() == []
    host.bus.set_faults(faults(reboot=["rear_left"]))
    assert boots() == [0x703]


def test_name_that_is_not_of_a_wheel_is_refused_and_changes_nothing():
    host = Host()
    host.bus.set_faults(faults(silent=["front_left"]))
    before = host.bus.faults
    for name in (*FAULT_FLAGS, "reboot"):
        with pytest.raises(ParameterError, match="nobody"):
            host.bus.set_faults(faults(**{name: ["nobody"]}))
    with pytest.raises(ParameterError):
        host.bus.configure(host.robot, parameters(plant__lifted=True), faults(deaf=["nobody"]))
    with pytest.raises(ParameterError):
        host.bus.configure(
            host.robot, parameters(faults__stuck_wheel=["nobody"]), faults(deaf=["front_left"])
        )
    assert host.bus.faults == before
    assert min(host.bus.wheels.plant._loads) > 0.0  # not lifted
    assert drive_faults(faults(reboot=["front_left"]), NAMES)[0].reboots == 1


def test_frames_are_lost_both_ways_at_their_rate_and_by_the_seed():
    def run(seed):
        host = Host(seed=seed)
        host.configure()
        host.bus.set_faults(faults(lost_frames=0.2))
        heard, lost = host.bus.received, host.bus.lost
        counts = []
        for _ in range(200):
            host.tick(15, [0.0] * 4, wait=0.001)
            counts.append(len(host.got))
        return counts, (host.bus.lost - lost) / (host.bus.received - heard + host.bus.sent)

    counts, fraction = run(1)
    assert run(1)[0] == counts
    assert run(2)[0] != counts
    whole = [count for count in counts if count]
    assert 0.7 < len(whole) / len(counts) < 0.9  # the SYNC itself is lost
    assert 0.7 * 8 < np.mean(whole) < 0.9 * 8
    assert 0.05 < fraction < 0.35


# installations


@pytest.mark.parametrize(
    "bad",
    [
        {"nodes": [1, 2, 3]},
        {"nodes": [1, 1, 2, 3]},
        {"nodes": [0, 1, 2, 3]},
        {"direction": [1.0, 1.0]},
        {"direction": [0.5]},
    ],
    ids=str,
)
def test_installation_that_does_not_fit_is_refused(bad):
    with pytest.raises(ParameterError):
        SimulatedBus(robot("omniman"), parameters(), installation(**bad))


@pytest.mark.parametrize("protocol", ["cia402", "vesc", "odrive"])
def test_each_protocol_makes_a_drive_for_each_wheel(protocol):
    bus = SimulatedBus(robot("omniman"), parameters(), installation(protocol=protocol))
    assert tuple(bus.drives) == NAMES
    now = 1.0
    frames = []
    for _ in range(200):
        now += 0.001
        frames += bus.advance(now)
    assert frames
    assert not any(unit.mode is DriveUnitMode.VELOCITY for unit in bus.wheels.units)
    assert not any(wheel.speed for wheel in bus.wheels.plant.wheels)


def test_scales_and_rated_torque_are_those_of_the_installation():
    host = Host(changes={"velocity_scale": 60.0, "rated_torque": 0.5})
    motor = host.robot.motor
    answers = {}
    for index in (0x6076, 0x6075, 0x6085, 0x608F):
        sub = 1 if index == 0x608F else 0
        request = struct.pack("<BHB4x", 0x40, index, sub)
        answers[index] = struct.unpack_from("<L", host.send(0x602, request)[0].data, 4)[0]
    assert answers[0x6076] == 500
    assert answers[0x6075] == pytest.approx(500.0 / motor.torque_constant, abs=1)
    assert answers[0x6085] == pytest.approx(9.0 * motor.gear_ratio * 60 / TURN, abs=1)
    assert answers[0x608F] == COUNTS


# echoes


def message(can_id=0x181, data=b"\x01\x02", **kind):
    return can.Message(arbitration_id=can_id, data=data, **{"is_extended_id": False, **kind})


def test_each_own_frame_is_treated_as_an_echo_once():
    own = EchoFilter()
    own.record_sent(message(), 1.0)
    own.record_sent(message(), 1.0)
    assert own.is_echo(message(), 1.1)
    assert own.is_echo(message(), 1.1)
    assert not own.is_echo(message(), 1.1)


@pytest.mark.parametrize(
    "other", [message(0x182), message(data=b"\x01"), message(is_extended_id=True)], ids=str
)
def test_frames_of_others_are_no_echoes(other):
    own = EchoFilter()
    own.record_sent(message(), 1.0)
    assert not own.is_echo(other, 1.0)
    assert own.is_echo(message(), 1.0)


def test_echo_that_never_came_is_forgotten():
    own = EchoFilter()
    for k in range(1000):
        own.record_sent(message(data=k.to_bytes(2, "little")), 0.01 * k)
    assert len(own._sent) < 200
    own.record_sent(message(), 20.0)
    assert not own.is_echo(message(), 20.6)


def test_a_wheel_whose_motor_is_repaired_drives_again():
    """Its unit has switched off for the open circuit, which no frame tells the host."""
    host = Host(plant__lifted=True)
    host.configure()
    host.drive(1.0, [3.0] * 4)
    whole = host.bus._simulation
    broken = replace(whole, faults=replace(whole.faults, dead_motor=("rear_right",)))
    host.bus.configure(host.robot, broken, faults())
    host.drive(2.0, [3.0] * 4)
    assert host.bus.wheels.velocity(3) < 0.5
    host.bus.configure(host.robot, whole, faults())
    host.drive(2.0, [3.0] * 4)
    assert host.bus.wheels.velocity(3) == pytest.approx(3.0, rel=0.05)
