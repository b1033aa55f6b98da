"""The whole identification of friction on the simulated drive, on stepped time."""

import numpy as np
import pytest

from omniman_ros.core.parameters import build
from omniman_ros.identification.friction.experiment import ExperimentPhase, FrictionExperiment
from omniman_ros.identification.friction.friction_fit import identify_friction
from omniman_ros.identification.friction.level_samples import ExperimentError
from omniman_ros.identification.friction.voltage_plan import make_plan
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives
from test import robots

FACTORS = (1.2, 0.8, 1.1, 0.9)
PERIOD = 0.02
SPIKES = 0.01


def run_experiment(name, noise, seed, precision=0.005, rounds=2, **changes):
    """Run the experiment as the command does; return the experiment and the drives.

    Voltage mode uses neither current nor speed, so a coarse substep is enough, which is ten times
    faster.
    """
    robot = robots.robot(name)
    values = {
        "plant.lifted": True,
        "plant.substep": 0.01,
        "faults.current_noise": noise,
        "mismatch.friction": FACTORS[: robot.wheel_count],
        "mismatch.torque_constant": [1.01],
    }
    drives = SimulatedDrives(robot, build(SimulationParameters, {**values, **changes}), seed)
    rng = np.random.default_rng(seed)
    now = 20.0
    plan = make_plan(robot, precision=precision, rounds=rounds)
    experiment = FrictionExperiment(robot, plan, now)
    drives.advance(now)
    while experiment.phase is not ExperimentPhase.DONE:
        now += PERIOD
        assert now < 20.0 + plan.longest_time
        states = drives.wheel_states(now)
        experiment.on_wheels(now, states.position, states.velocity, now)
        voltage, current, _ = drives.electrical().T
        spikes = rng.random(len(current)) < SPIKES
        current = current + spikes * rng.normal(0.0, 20.0 * noise, len(current))
        experiment.on_electrical(voltage, current, now)
        drives.command_voltage(experiment.voltages(now), now)
    return experiment, drives


@pytest.mark.parametrize(
    ("name", "noise", "precision", "rounds", "seed"),
    [
        # 1 % of the IG42's rated 2.1 A
        ("ig42", 0.021, 0.02, 1, 1),
        # 3 % of it; 2 % of the current of 250 W at 48 V
        pytest.param("ig42", 0.063, 0.006, 2, 1, marks=pytest.mark.exhaustive),
        pytest.param("ig42", 0.063, 0.006, 2, 2, marks=pytest.mark.exhaustive),
        pytest.param("omniman", 0.104, 0.01, 2, 1, marks=pytest.mark.exhaustive),
        pytest.param("omniman", 0.104, 0.01, 2, 2, marks=pytest.mark.exhaustive),
    ],
)
def test_friction_is_identified_within_5_percent(name, noise, precision, rounds, seed):
    """The currents are noisy with spikes, the encoder has steps, and K is 1 % off."""
    robot = robots.robot(name)
    a = np.array(robot.friction.viscous) * FACTORS
    b = np.array(robot.friction.coulomb) * FACTORS
    experiment, drives = run_experiment(name, noise, seed, precision, rounds)
    assert drives.stop_reason is None
    found = identify_friction(experiment.runs, robot)
    np.testing.assert_allclose([wheel.viscous.value for wheel in found], a, rtol=0.05)
    np.testing.assert_allclose([wheel.coulomb.value for wheel in found], b, rtol=0.05)
    np.testing.assert_allclose([wheel.back_emf_off for wheel in found], 0.01, atol=0.002)
    for wheel in found:
        assert not wheel.left_out and len(wheel.outliers) <= 2
    assert sum(run.spikes.sum() for run in experiment.runs) > 0
    speeds = np.abs([run.speed for run in experiment.runs])
    assert speeds.max() < robot.motor.max_speed


@pytest.mark.parametrize("name", ["omni3", pytest.param("mecanum6", marks=pytest.mark.exhaustive)])
def test_friction_of_other_robots_is_identified(name):
    robot = robots.robot(name)
    changes = {"mismatch.friction": [1.2], "mismatch.torque_constant": [1.0]}
    experiment, _ = run_experiment(name, 0.0, 0, precision=0.05, rounds=1, **changes)
    for k, wheel in enumerate(identify_friction(experiment.runs, robot)):
        assert wheel.coulomb.value == pytest.approx(1.2 * robot.friction.coulomb[k], rel=0.02)
        assert wheel.viscous.value == pytest.approx(1.2 * robot.friction.viscous[k], rel=0.02)


def test_a_dead_motor_is_named():
    with pytest.raises(ExperimentError, match=r"'rear_left' gives 0.00 V .* is the motor dead"):
        run_experiment("ig42", 0.05, 0, **{"faults.dead_motor": ["rear_left"]})


@pytest.mark.parametrize("name", ["ig42", "omniman"])
def test_a_robot_that_was_not_lifted_strains_and_does_not_drive_away(name):
    robot = robots.robot(name)
    values = {"plant.substep": 0.005}
    drives = SimulatedDrives(robot, build(SimulationParameters, values))
    experiment = FrictionExperiment(robot, make_plan(robot), 0.0)
    now = 0.0
    with pytest.raises(ExperimentError, match="does it touch the floor"):
        while now < 20.0:
            now += PERIOD
            states = drives.wheel_states(now)
            experiment.on_wheels(now, states.position, states.velocity, now)
            voltage, current, _ = drives.electrical().T
            experiment.on_electrical(voltage, current, now)
            drives.command_voltage(experiment.voltages(now), now)
    assert now < 3.0
    pose, _ = drives.ground_truth()
    assert np.hypot(*pose[:2]) < 0.02 and abs(pose[2]) < 0.02
