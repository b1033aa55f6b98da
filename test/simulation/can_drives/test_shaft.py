"""The shaft of a wheel's motor: conversions both ways, on the plant."""

import math

import numpy as np
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.can_drives.shaft import MotorShaft
from omniman_ros.simulation.plant.drive_unit import DriveUnitMode
from omniman_ros.simulation.plant.driven_wheels import DrivenWheels
from test.simulation.plant.support import parameters, robot


class Bench:
    """Wheels in the air, and the shaft of each."""

    def __init__(self, name="omniman", ratio=0.0, direction=1.0, changes=None, **settings):
        self.robot = robot(name, **(changes or {}))
        self.wheels = DrivenWheels(self.robot, parameters(plant__lifted=True, **settings))
        n = self.robot.wheel_count
        self.shafts = [MotorShaft(self.wheels, k, self.robot, ratio, direction) for k in range(n)]
        self.now = 0.0
        self.wheels.advance(0.0)

    def run(self, seconds, each=None):
        for _ in range(round(seconds / 0.001)):
            self.now += 0.001
            if each:
                each()
            self.wheels.advance(self.now)

    def speeds(self):
        return np.array([wheel.speed for wheel in self.wheels.plant.wheels])


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("ratio", [0.0, 7.0])
def test_speed_and_position_at_the_motor_are_those_of_the_wheel_through_the_gear(ratio, direction):
    bench = Bench(ratio=ratio, direction=direction)
    shaft, gear = bench.shafts[0], ratio or bench.robot.motor.gear_ratio
    assert shaft.gear_ratio == gear
    shaft.follow_velocity(3.0 * gear)
    bench.run(1.0)
    assert bench.speeds()[0] == pytest.approx(3.0 * direction, rel=0.01)
    assert shaft.velocity == pytest.approx(3.0 * gear, rel=0.02)
    assert shaft.position == pytest.approx(gear * direction * bench.wheels.position(0))
    assert shaft.position > gear


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("ratio", [0.0, 7.0])
def test_torque_at_the_motor_is_its_constant_times_its_current(ratio, direction):
    bench = Bench(ratio=ratio, direction=direction, faults__stuck_wheel=["front_left"])
    shaft, motor = bench.shafts[0], bench.robot.motor
    wanted = 0.3 * shaft.torque_constant * motor.max_current
    shaft.follow_torque(wanted)
    bench.run(0.1)
    assert shaft.torque == pytest.approx(wanted, rel=0.001)
    assert shaft.current == pytest.approx(0.3 * motor.max_current, rel=0.001)
    assert bench.wheels.plant.wheels[0].current == pytest.approx(direction * shaft.current)
    wheel = bench.wheels.torque(0) * direction
    assert wheel == pytest.approx(shaft.torque * shaft.gear_ratio * motor.gear_efficiency)
    if not ratio:
        assert shaft.torque_constant == motor.torque_constant


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_voltage_drives_forward_and_is_measured(direction):
    bench = Bench(direction=direction)
    bench.shafts[0].follow_voltage(6.0)
    bench.run(0.5)
    assert bench.shafts[0].voltage == 6.0
    assert bench.shafts[0].velocity > 0.0
    assert np.sign(bench.speeds()[0]) == direction
    assert bench.shafts[0].supply == bench.robot.motor.max_voltage


def test_feed_forward_torque_is_a_current():
    bench = Bench()
    shaft = bench.shafts[0]
    shaft.follow_velocity(0.0, 0.2)
    bench.run(0.002)
    assert bench.wheels.units[0].feedforward == pytest.approx(
        0.2 * shaft.gear_ratio * bench.robot.motor.gear_efficiency
    )


def test_halt_ramps_down_at_its_rate_and_holds():
    bench = Bench()
    shaft = bench.shafts[0]
    shaft.follow_velocity(8.0 * shaft.gear_ratio)
    bench.run(1.5)
    shaft.halt(16.0 * shaft.gear_ratio)
    bench.run(0.25)
    assert bench.speeds()[0] == pytest.approx(4.0, abs=0.4)
    bench.run(0.75)
    assert bench.speeds()[0] == 0.0


# release


def test_released_motor_coasts_without_current_and_can_be_driven_again_without_a_jerk():
    changes = {"friction__coulomb": [0.0], "friction__viscous": [0.0]}
    bench = Bench(changes=changes)
    shaft = bench.shafts[0]
    shaft.follow_velocity(5.0 * shaft.gear_ratio)
    bench.run(1.0)
    before = bench.speeds()[0]
    shaft.release()
    bench.run(1.0)
    assert shaft.current == 0.0
    assert bench.speeds()[0] == pytest.approx(before, rel=1e-6)
    assert not shaft.lost and not bench.wheels.units[0].open_circuit
    for drive in (lambda: shaft.follow_velocity(shaft.velocity), lambda: shaft.follow_torque(0.0)):
        bench.run(0.05, drive)
        assert bench.speeds()[0] == pytest.approx(before, rel=0.02)
        shaft.release()
        bench.run(0.2)
    shaft.follow_velocity(2.0 * shaft.gear_ratio)
    bench.run(1.0)
    assert bench.speeds()[0] == pytest.approx(2.0, rel=0.02)


def test_mode_after_a_release_begins_where_the_wheel_has_come_to():
    bench = Bench()
    shaft = bench.shafts[0]
    shaft.follow_velocity(8.0 * shaft.gear_ratio)
    bench.run(1.0)
    shaft.release()
    bench.run(0.3)
    speed = bench.speeds()[0]
    assert 1.0 < speed < 6.0
    shaft.follow_torque(0.0)
    bench.run(0.003)
    assert abs(shaft.current) < 0.02 * bench.robot.motor.max_current


def test_release_affects_one_wheel_and_persists_across_parameter_changes():
    bench = Bench()
    for shaft in bench.shafts:
        shaft.follow_velocity(3.0 * shaft.gear_ratio)
    bench.run(1.0)
    bench.shafts[1].release()
    bench.wheels.configure(bench.robot, parameters(plant__lifted=True))
    bench.run(0.5)
    assert bench.wheels.units[1].mode is DriveUnitMode.OFF
    assert bench.shafts[1].current == 0.0
    assert bench.speeds()[0] == pytest.approx(3.0, rel=0.02)
    assert bench.speeds()[1] < 2.9


def test_dead_motor_stays_dead_when_it_is_driven():
    bench = Bench(faults__dead_motor=["front_left"])
    bench.shafts[0].release()
    bench.shafts[0].follow_voltage(12.0)
    bench.run(0.2)
    assert bench.speeds()[0] == 0.0 and bench.speeds()[1] == 0.0
    bench.wheels.configure(bench.robot, parameters(plant__lifted=True))
    bench.shafts[0].release()
    bench.shafts[0].follow_voltage(12.0)
    bench.run(0.2)
    assert bench.speeds()[0] > 1.0


def test_energy_balances_through_releases():
    bench = Bench("ig42")
    for k in range(6):
        for shaft in bench.shafts:
            shaft.follow_voltage(10.0 - 4.0 * k)
        bench.run(0.1)
        bench.shafts[k % 4].release()
        bench.run(0.1)
    energy = bench.wheels.energy
    assert energy.turnover > 1.0
    assert abs(energy.residual) <= 1e-9 * energy.turnover


def test_frozen_encoder_is_found_and_forgotten_by_a_release():
    bench = Bench("ig42")
    shaft = bench.shafts[1]
    shaft.follow_velocity(3.0 * shaft.gear_ratio)
    bench.run(1.0)
    frozen = parameters(plant__lifted=True, faults__frozen_encoder=["front_right"])
    bench.wheels.configure(bench.robot, frozen)
    bench.run(0.5, lambda: shaft.follow_torque(2.0 * shaft.torque_constant))
    assert shaft.lost
    shaft.release()
    assert not shaft.lost


@pytest.mark.parametrize(
    "bad", [{"ratio": -1.0}, {"ratio": math.nan}, {"direction": 0.5}], ids=str
)
def test_invalid_gear_or_direction_is_refused(bad):
    with pytest.raises(ParameterError):
        Bench(**bad)
