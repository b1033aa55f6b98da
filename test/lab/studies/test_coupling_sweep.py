import numpy as np
import pytest

from omniman_ros.lab.studies.coupling import Case, Outcome, Run, draw_mismatch
from omniman_ros.lab.studies.coupling_sweep import FULL, QUICK, STANDARD, cases, summary
from test import robots

FIGURES = Outcome.__dataclass_fields__


def made(group, sample, gain, epsilon_max, **figures):
    case = Case(group, sample, gain, draw_mismatch(group, 0, sample, 4))
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
            gains = [case.gain for case in same]
            assert {0.0, 2.0, 7.5} <= set(gains)
            assert len(gains) == len(set(gains))
            assert len({case.mismatch for case in same}) == 1
    assert len({case.mismatch for case in todo if case.group == "P"}) == plan.samples


def test_study_has_at_least_ten_random_wheels():
    assert STANDARD.samples >= 10
    assert FULL.samples > STANDARD.samples


def test_another_seed_gives_another_set_of_wheels():
    one, other = (cases(QUICK, robots.values("omniman"), 10.0, seed) for seed in (0, 1))
    assert one[0].mismatch != other[0].mismatch
