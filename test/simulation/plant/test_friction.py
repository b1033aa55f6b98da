"""Motor, gear and shaft friction of one wheel, on a lifted platform."""

import numpy as np
import pytest

from omniman_ros.simulation.plant.plant import Plant
from test.simulation.plant.support import parameters, robot

BACK_EMF, RESISTANCE, ETA, COULOMB = 0.0325 * 24, 1.85, 0.66, 0.25


def lifted(**changes):
    robots = {key: changes.pop(key) for key in list(changes) if key.startswith(("motor", "fric"))}
    return Plant(robot("ig42", **robots), parameters(plant__lifted=True, **changes))


def run(plant, voltages, seconds):
    for _ in range(round(seconds / 0.001)):
        plant.step(voltages)


def stall_voltage(torque):
    """Return the voltage for a torque behind the gear at rest."""
    return torque / ETA / BACK_EMF * RESISTANCE


def test_wheel_below_breakaway_stays_exactly_at_rest():
    plant = lifted()
    run(plant, [stall_voltage(1.19 * COULOMB), -stall_voltage(1.19 * COULOMB), 0.0, 0.0], 0.2)
    assert [wheel.speed for wheel in plant.wheels] == [0.0] * 4
    assert [wheel.angle for wheel in plant.wheels] == [0.0] * 4
    assert plant.energy.copper > 0
    assert plant.energy.shaft == 0.0


def test_wheel_above_breakaway_turns_and_then_needs_less_torque():
    plant = lifted()
    run(plant, [stall_voltage(1.21 * COULOMB)] * 4, 0.1)
    assert min(wheel.speed for wheel in plant.wheels) > 0.01
    turning = lifted()
    turning.set_wheel_speeds([0.5] * 4)
    # kept in motion by a torque below breakaway: 1.1 b, less the back-EMF
    run(turning, [stall_voltage(1.1 * COULOMB)] * 4, 0.5)
    assert min(wheel.speed for wheel in turning.wheels) > 0.01


def test_friction_stops_a_wheel_in_the_expected_time_and_permanently():
    plant = lifted(friction__viscous=[0.0], faults__dead_motor=robot("ig42").wheels.names)
    speed = 5.0
    plant.set_wheel_speeds([speed, -speed, speed, -speed])
    time = speed * 0.012 / COULOMB
    run(plant, [24.0] * 4, time - 0.003)
    assert min(abs(wheel.speed) for wheel in plant.wheels) > 0
    run(plant, [24.0] * 4, 0.005)
    assert [wheel.speed for wheel in plant.wheels] == [0.0] * 4
    expected = 0.5 * speed**2 * 0.012 / COULOMB
    angles = [wheel.angle for wheel in plant.wheels]
    np.testing.assert_allclose(angles, expected * np.array([1, -1, 1, -1]), rtol=1e-3)
    assert plant.energy.shaft == pytest.approx(4 * 0.5 * 0.012 * speed**2)


def test_no_load_and_torque_point_of_the_motor():
    plant = lifted(friction__viscous=[0.0])
    run(plant, [24.0] * 4, 1.0)
    wheel = plant.wheels[0]
    assert BACK_EMF * wheel.mean_current * ETA == pytest.approx(COULOMB, rel=1e-6)
    assert pytest.approx(RESISTANCE * wheel.mean_current + BACK_EMF * wheel.speed) == 24.0


def test_gear_loses_power_in_both_directions():
    """Driving, the wheel gets eta of the motor's work; driven, the reverse holds."""
    driving = lifted(friction__coulomb=[0.0], friction__viscous=[0.0])
    run(driving, [12.0] * 4, 0.3)
    energy = driving.energy
    mechanical = energy.electrical - energy.copper - energy.inductive
    assert energy.kinetic == pytest.approx(ETA * mechanical, rel=1e-6)

    driven = lifted(friction__coulomb=[0.0], friction__viscous=[0.0])
    driven.set_wheel_speeds([20.0] * 4)
    given = driven.kinetic
    for _ in range(300):
        # follow the back-EMF closely from below: the motor brakes and returns current
        driven.step([0.8 * BACK_EMF * wheel.speed for wheel in driven.wheels])
    energy = driven.energy
    recovered = energy.copper - energy.electrical + energy.inductive
    assert energy.electrical < 0
    assert recovered == pytest.approx(ETA * (given - driven.kinetic), rel=1e-6)


@pytest.mark.parametrize(("front", "moves"), [(1.5, False), (3.0, True)])
def test_gear_losses_hold_a_driven_wheel(front, moves):
    """Rear wheels hold 1 N m at the motor against front wheels that push the platform.

    They are driven backwards only by more than 1 / eta = 1.52 N m; the front gives eta of its own.
    """
    changes = {"friction__coulomb": [0.0], "friction__roller": [0.0], "friction__mu": 5.0}
    plant = Plant(robot("ig42", **changes), parameters())
    volts = np.array([front, front, -1.0, -1.0]) / BACK_EMF * RESISTANCE
    run(plant, volts, 0.3)
    rear = [wheel.speed for wheel in plant.wheels[2:]]
    if moves:
        assert min(rear) > 0.1
    else:
        assert rear == [0.0, 0.0]
        assert plant.twist[0] < 0.01


def test_current_and_voltage_stay_within_their_limits():
    plant = Plant(robot("omniman"), parameters())
    rng = np.random.default_rng(5)
    highest = 0.0
    for k in range(2000):
        if k % 40 == 0:
            voltages = rng.uniform(-100, 100, 4).tolist()
        plant.step(voltages)
        for wheel in plant.wheels:
            assert abs(wheel.voltage) <= 48.0
            highest = max(highest, abs(wheel.mean_current), abs(wheel.current))
    assert 24.0 < highest < 25.0 * 1.02


def test_current_rises_with_the_time_constant_of_the_winding():
    plant = lifted(motor__inductance=0.01, faults__stuck_wheel=robot("ig42").wheels.names)
    run(plant, [10.0] * 4, 0.005)
    expected = 10.0 / RESISTANCE * (1 - np.exp(-0.005 * RESISTANCE / 0.01))
    assert plant.wheels[0].current == pytest.approx(expected, rel=2e-3)
    assert plant.wheels[0].speed == 0.0


@pytest.mark.parametrize("inductance", [0.0, 1e-6, 1e-4, 1e-3, 3e-2])
def test_current_does_not_ring_at_any_inductance(inductance):
    plant = lifted(motor__inductance=inductance, faults__stuck_wheel=robot("ig42").wheels.names)
    final = 5.0 / RESISTANCE
    for _ in range(300):
        plant.step([5.0] * 4)
        assert plant.wheels[0].current <= final * 1.6
    assert plant.wheels[0].current == pytest.approx(final, rel=1e-6)


def test_mismatch_acts_on_each_wheel_separately():
    plant = lifted(
        mismatch__torque_constant=[1.0, 0.9, 1.0, 1.0],
        mismatch__amplifier_gain=[1.0, 1.0, 1.1, 1.0],
    )
    run(plant, [12.0] * 4, 1.0)
    nominal, weaker, louder, same = (wheel.speed for wheel in plant.wheels)
    assert nominal == same < weaker < louder
    assert plant.wheels[2].voltage == pytest.approx(13.2)


@pytest.mark.parametrize("kind", ["friction__viscous", "friction__coulomb"])
def test_friction_mismatch_acts_on_both_kinds_of_friction(kind):
    none = {"friction__viscous": [0.0], "friction__coulomb": [0.0]}
    plant = lifted(**{**none, kind: [0.1]}, mismatch__friction=[2.0, 1.0, 1.0, 0.0])
    run(plant, [12.0] * 4, 0.5)
    more, nominal, same, without = (wheel.speed for wheel in plant.wheels)
    assert more < nominal == same < without
