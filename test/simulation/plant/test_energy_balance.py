"""Work supplied = losses + change of stored energy, each from its own expression."""

import numpy as np
import pytest

from omniman_ros.simulation.plant.energy_ledger import EnergyLedger
from omniman_ros.simulation.plant.plant import Plant
from test.simulation.plant.support import parameters, robot

MISMATCH = {
    "mismatch__friction": [1.3, 0.8, 1.0, 1.1],
    "mismatch__torque_constant": [1.05, 0.95, 1.0, 0.98],
    "mismatch__amplifier_gain": [0.97, 1.02, 1.0, 1.05],
    "mismatch__radius": [1.0, 1.01, 0.99, 1.0],
}


def kinetic(plant, machine):
    """Return the kinetic energy from the reported state, part by part."""
    vx, vy, w = plant.twist
    total = 0.0
    for part in (machine.body, machine.arm):
        speed2 = (vx - w * part.com_y) ** 2 + (vy + w * part.com_x) ** 2
        total += 0.5 * part.mass * speed2 + 0.5 * part.inertia * w * w
    inertia = machine.wheels.inertia
    return total + sum(0.5 * inertia[k] * wheel.speed**2 for k, wheel in enumerate(plant.wheels))


def check(machine, settings, voltages_at, steps=1500):
    """Run and check the balance at each step against an external meter."""
    plant = Plant(machine, settings)
    start = kinetic(plant, machine)
    electrical = 0.0
    last = plant.energy
    for k in range(steps):
        plant.step(voltages_at(k))
        electrical += settings.plant.substep * sum(
            wheel.voltage * wheel.mean_current for wheel in plant.wheels
        )
        energy = plant.energy
        for name, value in energy.losses.items():
            # a wheel that stops within a step may give back less than this
            assert value >= getattr(last, name) - 1e-12, (name, k)
        last = energy
    assert plant.unsettled == 0
    assert energy.turnover > 0.01
    assert abs(energy.residual) <= 1e-3 * energy.turnover  # the requested voltage
    assert abs(energy.residual) <= 1e-10 * energy.turnover  # the actual voltage
    assert energy.electrical == pytest.approx(electrical, rel=1e-9)
    assert energy.kinetic == pytest.approx(kinetic(plant, machine) - start, rel=1e-9, abs=1e-9)
    return energy


def pattern(signs, volts):
    return lambda k: [sign * volts for sign in signs]


@pytest.mark.parametrize("mismatch", [{}, MISMATCH], ids=["equal", "mismatch"])
@pytest.mark.parametrize("name", ["omniman", "ig42"])
class TestBothRobots:
    def test_energy_balances_when_braking(self, name, mismatch):
        energy = check(
            robot(name), parameters(**mismatch), lambda k: [12.0 if k < 800 else 0.0] * 4
        )
        assert energy.kinetic < 0.1 * energy.electrical

    def test_energy_balances_with_opposed_wheels(self, name, mismatch):
        energy = check(robot(name), parameters(**mismatch), pattern((1, 1, -1, -1), 12.0))
        assert energy.slip > 5.0


@pytest.mark.parametrize("seed", range(8))
def test_energy_balances_for_random_robots_and_floors(seed):
    rng = np.random.default_rng(100 + seed)
    machine = robot(
        ["ig42", "omniman"][seed % 2],
        body__com_x=float(rng.uniform(-0.05, 0.05)),
        body__com_y=float(rng.uniform(-0.05, 0.05)),
        motor__inductance=float(rng.choice([0.0, 1e-5, 1e-3, 1e-2])),
        motor__gear_efficiency=float(rng.choice([0.3, 0.7, 1.0])),
        friction__mu=float(rng.choice([0.05, 0.6, 2.0])),
        friction__coulomb=rng.choice([0.0, 0.3, 2.0], 4).tolist(),
        friction__roller=[float(rng.choice([0.0, 0.05]))],
    )
    settings = parameters(
        plant__slip_velocity=float(rng.choice([1e-4, 5e-3, 0.1])),
        plant__substep=float(rng.choice([5e-4, 1e-3, 3e-3])),
        plant__patch_x_min=-0.1,
        plant__patch_x_max=5.0,
        plant__patch_y_min=-5.0,
        plant__patch_y_max=0.0,
        **MISMATCH,
    )
    full = machine.motor.max_voltage
    table = rng.uniform(-full, full, (60, 4))
    check(machine, settings, lambda k: table[k // 25].tolist())


def test_faults_and_changes_in_motion_keep_the_balance():
    plant = Plant(robot("omniman"), parameters())

    def run(count):
        for _ in range(count):
            plant.step([20.0, 18.0, 21.0, 15.0])

    run(500)
    plant.configure(robot("omniman"), parameters(faults__dead_motor=["front_left"]))
    run(200)
    assert plant.wheels[0].mean_current == 0.0
    plant.configure(robot("omniman"), parameters(faults__stuck_wheel=["rear_left"]))
    run(200)
    assert plant.wheels[2].speed == 0.0
    assert plant.wheels[0].mean_current != 0.0
    plant.configure(robot("omniman", arm__mass=15.0, body__com_x=0.05), parameters())
    run(200)
    energy = plant.energy
    assert energy.external != 0.0
    assert abs(energy.residual) <= 1e-10 * energy.turnover


def test_residual_is_the_imbalance():
    ledger = EnergyLedger(
        electrical=10.0,
        external=1.0,
        copper=2.0,
        gear=1.0,
        shaft=1.0,
        roller=0.5,
        slip=0.5,
        kinetic=4.0,
        inductive=0.25,
        turnover=20.0,
    )
    assert ledger.residual == pytest.approx(1.75)
    assert ledger.losses == {"copper": 2, "gear": 1, "shaft": 1, "roller": 0.5, "slip": 0.5}
