import numpy as np
import pytest

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.lab.studies.coupling import (
    OWN_CONTROLLER,
    PAPER_CONTROLLER,
    Case,
    Outcome,
    Run,
    draw_mismatch,
)
from omniman_ros.lab.studies.coupling_sweep import (
    FULL,
    PAPER_GAIN,
    QUICK,
    STANDARD,
    cases,
    printed_gain,
    stability,
    step_grid,
    summary,
)
from omniman_ros.lab.studies.delay import Response
from test import robots

FIGURES = Outcome.__dataclass_fields__


def made(group, sample, gain, epsilon_max, controller=OWN_CONTROLLER, **figures):
    case = Case(group, sample, gain, draw_mismatch(group, 0, sample, 4), controller)
    outcome = Outcome(**{**dict.fromkeys(FIGURES, 1.0), "epsilon_max": epsilon_max, **figures})
    return Run(case, outcome, np.zeros(1), np.zeros((1, 1)))


def test_sweep_has_a_row_per_group_and_gain_with_mean_and_worst_value():
    rows = summary(
        [
            made("P", 0, 0.0, 1.0, slip=10.0),
            made("P", 0, 2.0, 0.5, slip=4.0),
            made("P", 1, 0.0, 4.0, slip=20.0),
            made("P", 1, 2.0, 0.4, slip=5.0),
            made("PI", 0, 0.0, 0.2),
            made("PI", 0, 2.0, 0.1),
        ]
    )
    assert [(row["group"], row["k"]) for row in rows] == [
        ("P", 0.0),
        ("P", 2.0),
        ("PI", 0.0),
        ("PI", 2.0),
    ]
    off, paper = rows[:2]
    assert off["slip"] == {"mean": 15.0, "worst": 20.0}
    assert paper["slip"] == {"mean": 4.5, "worst": 5.0}
    assert off["epsilon_ratio"] == {"mean": 1.0, "worst": 1.0}
    # Each relative to its own wheels without control: 0.5 / 1 and 0.4 / 4.
    assert paper["epsilon_ratio"]["mean"] == pytest.approx(0.3)
    assert paper["epsilon_ratio"]["worst"] == pytest.approx(0.5)
    assert paper["epsilon_max_samples"] == [0.5, 0.4]


@pytest.mark.parametrize("plan", [QUICK, STANDARD, FULL], ids=["quick", "standard", "full"])
def test_every_group_has_no_control_the_paper_gain_and_the_robot_gain(plan):
    todo = cases(plan, robots.values("omniman"), 7.5, seed=0)
    for group in plan.gains:
        for sample in range(plan.samples):
            same = [case for case in todo if (case.group, case.sample) == (group, sample)]
            gains = [(case.controller, case.gain) for case in same]
            assert {(OWN_CONTROLLER, gain) for gain in (0.0, 2.0, 7.5)} <= set(gains)
            printed = printed_gain(robots.values("omniman"))
            assert {(PAPER_CONTROLLER, gain) for gain in (2.0, printed)} <= set(gains)
            assert len(gains) == len(set(gains))
            assert len({case.mismatch for case in same}) == 1
    assert len({case.mismatch for case in todo if case.group == "P"}) == plan.samples


def test_study_has_at_least_ten_random_wheels():
    assert STANDARD.samples >= 10
    assert FULL.samples > STANDARD.samples


def test_another_seed_gives_another_set_of_wheels():
    one, other = (cases(QUICK, robots.values("omniman"), 10.0, seed) for seed in (0, 1))
    assert one[0].mismatch != other[0].mismatch


def test_paper_rows_are_relative_to_the_same_wheels_without_control():
    rows = summary(
        [
            made("P", 0, 0.0, 2.0),
            made("P", 0, 2.0, 1.0),
            made("P", 0, 2.0, 0.5, controller=PAPER_CONTROLLER),
        ]
    )
    found = {(row["controller"], row["k"]): row["epsilon_ratio"]["mean"] for row in rows}
    assert found == {
        (OWN_CONTROLLER, 0.0): 1.0,
        (OWN_CONTROLLER, 2.0): 0.5,
        (PAPER_CONTROLLER, 2.0): 0.25,
    }


@pytest.mark.parametrize("name", robots.SHIPPED)
def test_printed_gain_gives_the_correction_of_18_as_printed(name):
    robot = robots.robot(name)
    model = PlatformKinematics(robot.wheels)
    signs = np.sign(model.T_pinv[:, 0])
    printed = signs / robot.wheels.radius[0]  # the last column of (18)
    np.testing.assert_allclose(
        printed_gain(robots.values(name)) * model.T_pinv[:, 0], PAPER_GAIN * printed
    )


@pytest.mark.parametrize("name", ["mecanum6", "skewed4", "omni3"])
def test_there_is_no_printed_gain_for_wheels_that_18_does_not_describe(name):
    assert printed_gain(robots.values(name)) is None


def test_step_responses_cover_the_printed_gain_on_blocks_and_on_the_floor():
    grid = step_grid(QUICK, robots.values("omniman"), 7.5)
    gains = {2.0, 7.5, 30.0, printed_gain(robots.values("omniman"))}
    for lifted in (True, False):
        assert {step.gain for step in grid if step.lifted is lifted} == gains


def test_stability_counts_only_steps_on_blocks_and_brackets_the_delay():
    def step(gain, delay, settled, lifted=True):
        return Response(gain, delay, lifted, 0.0, 0.0 if settled else 2.0)

    found = stability(
        robots.values("omniman"),
        [
            step(63.0, 0.0, True),
            step(63.0, 0.01, True),
            step(63.0, 0.03, False),
            step(63.0, 0.05, True),  # contradicts the model
            step(63.0, 0.02, True, lifted=False),
        ],
        [63.0],
    )
    assert (found["compared"], found["agree"]) == (4, 3)
    (margin,) = found["margins"]
    assert (margin["settles_s"], margin["oscillates_s"]) == (0.01, 0.03)
    assert 0.01 < margin["computed_s"] < 0.03
    gains = [row["k"] for row in found["boundary"]]
    assert gains == sorted(gains, reverse=True)
