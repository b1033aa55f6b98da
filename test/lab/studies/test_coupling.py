from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.control.coupling_controller import CouplingParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.lab.studies.coupling import (
    MISMATCH_SPREAD,
    PAPER_CONTROLLER,
    Case,
    Setup,
    StudyError,
    draw_mismatch,
    drive,
    noise,
)
from omniman_ros.lab.studies.coupling_sweep import AIM, PAPER_GAIN, QUICK, printed_gain, sweep
from test import robots

DEFAULT = build(CouplingParameters, {}).k_epsilon
GAINS = (0.0, PAPER_GAIN, DEFAULT)


# ---- measured quantities ---------------------------------------------------------------------


def test_noise_is_the_part_faster_than_the_window():
    time = PERIOD * np.arange(4000)
    slow = np.column_stack([2 * np.sin(0.5 * time), 3 * time])
    assert noise(slow) < 1e-3
    fast = 0.2 * np.sign(np.sin(2 * np.pi * 100 * time + 0.5))
    assert noise(slow + fast[:, None]) == pytest.approx(0.2, rel=0.06)


def test_random_wheels_are_seeded_and_differ_between_groups_by_radius_only():
    one = draw_mismatch("P", 7, 3, 4)
    assert one == draw_mismatch("P", 7, 3, 4)
    assert one.radius == (1.0,) * 4
    other = draw_mismatch("radii", 7, 3, 4)
    assert replace(other, radius=one.radius) == one
    assert 0.0 < max(abs(factor - 1.0) for factor in other.radius) <= 0.005
    assert draw_mismatch("P", 7, 4, 4) != one
    assert draw_mismatch("P", 8, 3, 4) != one


def test_random_wheels_fill_their_spread():
    drawn = [draw_mismatch("P", 0, sample, 4) for sample in range(50)]
    for name in ("friction", "torque_constant", "amplifier_gain"):
        factors = np.array([getattr(mismatch, name) for mismatch in drawn])
        assert abs(factors - 1.0).max() <= MISMATCH_SPREAD
        assert abs(factors - 1.0).max() > 0.95 * MISMATCH_SPREAD
        assert factors.mean() == pytest.approx(1.0, abs=0.03)


def test_robot_with_three_wheels_is_refused():
    with pytest.raises(ParameterError, match="no motion constraint"):
        Setup(robots.values("omni3"), QUICK.figure)


# ---- drives ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def setup():
    return Setup(robots.values("omniman"), QUICK.figure)


@pytest.fixture(scope="module")
def drives(setup):
    """Return drives by gain for the same wheels with P loops."""
    wheels = draw_mismatch("P", 0, 0, 4)
    chosen = [Case("P", 0, gain, wheels) for gain in GAINS]
    return {run.case.gain: run for run in sweep(setup, chosen, workers=2)}


@pytest.mark.exhaustive
def test_coupling_control_reduces_the_error_and_more_at_a_higher_gain(drives):
    off, paper, chosen = (drives[gain].outcome for gain in GAINS)
    assert off.epsilon_max > 0.5
    assert paper.epsilon_max < 0.5 * off.epsilon_max
    assert chosen.epsilon_max < 1.25 * AIM * off.epsilon_max
    assert off.epsilon_rms > 2 * paper.epsilon_rms > 4 * chosen.epsilon_rms


@pytest.mark.exhaustive
def test_coupling_control_saves_slip_losses_and_energy_without_noise(drives):
    off, paper, chosen = (drives[gain].outcome for gain in GAINS)
    assert chosen.slip < 0.5 * paper.slip < 0.25 * off.slip
    assert chosen.energy < paper.energy < off.energy
    assert chosen.command_noise < 1.2 * off.command_noise
    assert chosen.speed_noise < 1.2 * off.speed_noise


@pytest.mark.exhaustive
def test_path_speed_and_duration_are_equal_for_all_gains(drives, setup):
    for run in drives.values():
        assert run.outcome.duration == pytest.approx(setup.figure.duration, abs=PERIOD)
        assert run.outcome.tracking_max < 0.02
        np.testing.assert_array_equal(run.time, drives[0.0].time)


@pytest.mark.exhaustive
def test_all_energy_is_accounted_for(drives):
    for run in drives.values():
        outcome = run.outcome
        assert abs(outcome.imbalance) < 1e-9 * outcome.energy
        assert outcome.losses == pytest.approx(outcome.energy, rel=1e-6)  # at rest at the end
        assert 0.0 < outcome.slip < outcome.losses
        assert 0.0 < outcome.copper < outcome.losses


@pytest.mark.exhaustive
def test_epsilon_continues_across_movements(drives, setup):
    """The controller resets its own integral at every rest."""
    run = drives[0.0]
    assert np.abs(run.epsilon[0]).max() == 0.0
    assert np.abs(run.epsilon).max() == pytest.approx(run.outcome.epsilon_max, rel=1e-3)
    assert np.abs(np.diff(run.epsilon, axis=0)).max() < 0.05
    for leg in setup.figure.legs(PERIOD)[1:]:
        before = np.searchsorted(run.time, leg.begin) - 1
        assert abs(run.epsilon[before, 0]) > 0.01


@pytest.mark.exhaustive
def test_drive_is_reproducible_in_another_process(setup, drives):
    there = drives[DEFAULT]
    (here,) = sweep(setup, [there.case], workers=1)
    assert here.outcome == there.outcome
    np.testing.assert_array_equal(here.epsilon, there.epsilon)


@pytest.mark.exhaustive
def test_paper_as_printed_meets_its_figure_and_with_j_a_corrected_does_not(setup, drives):
    wheels = draw_mismatch("P", 0, 0, 4)
    gains = (PAPER_GAIN, printed_gain(setup.robot))
    chosen = [Case("P", 0, gain, wheels, PAPER_CONTROLLER) for gain in gains]
    corrected, printed = (run.outcome.epsilon_max for run in sweep(setup, chosen, workers=2))
    off = drives[0.0].outcome.epsilon_max
    assert printed < 0.2 * AIM * off
    assert corrected > 2.0 * AIM * off
    # Rests reset the error of this package's controller, hence it leaves more.
    assert corrected < drives[PAPER_GAIN].outcome.epsilon_max


@pytest.mark.exhaustive
def test_late_commands_do_not_cost_accuracy_on_a_floor_that_grips(setup, drives):
    wheels = draw_mismatch("late", 0, 0, 4)
    printed = Case("late", 0, printed_gain(setup.robot), wheels, PAPER_CONTROLLER)
    late = drive(setup, printed).outcome
    assert late.epsilon_max < 0.2 * AIM * drives[0.0].outcome.epsilon_max


@pytest.mark.exhaustive
def test_unfinished_drive_has_no_figures(setup):
    stuck = Setup({**setup.robot, "faults.stuck_wheel": ("front_left",)}, setup.figure)
    with pytest.raises(StudyError, match="group PI, sample 5, k = 2: path cancelled"):
        drive(stuck, Case("PI", 5, 2.0, draw_mismatch("PI", 0, 0, 4)))
