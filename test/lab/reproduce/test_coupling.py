"""`omniman reproduce coupling`: its cases, figures and aims."""

import numpy as np
import pytest

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.lab.reproduce import coupling
from omniman_ros.lab.reproduce.coupling import PAPER_GAIN, STANDARD, cases, printed_gain, summary
from omniman_ros.lab.studies.coupling import (
    LAG_CONTROLLER,
    OWN_CONTROLLER,
    PAPER_CONTROLLER,
    CouplingCase,
    CouplingFigures,
    CouplingRun,
    draw_mismatch,
)
from test import robots

OMNIMAN = robots.values("omniman")


def made(group, sample, gain, epsilon_max, controller=OWN_CONTROLLER):
    case = CouplingCase(group, sample, gain, draw_mismatch(group, 0, sample, 4), controller)
    outcome = CouplingFigures(
        **dict.fromkeys(CouplingFigures.__dataclass_fields__, 1.0) | {"epsilon_max": epsilon_max}
    )
    time = np.linspace(0.0, STANDARD.figure.duration, 20)
    return CouplingRun(case, outcome, time, np.outer(np.sin(time), [epsilon_max]))


@pytest.mark.parametrize(
    ("in_world", "controllers"),
    [
        (
            False,
            [
                (OWN_CONTROLLER, 0.0),
                (OWN_CONTROLLER, 15.0),
                (PAPER_CONTROLLER, PAPER_GAIN),
                (PAPER_CONTROLLER, printed_gain(OMNIMAN)),
            ],
        ),
        (
            True,
            [
                (OWN_CONTROLLER, 0.0),
                (OWN_CONTROLLER, 5.0),
                (OWN_CONTROLLER, 15.0),
                (LAG_CONTROLLER, 5.0),
                (LAG_CONTROLLER, 15.0),
            ],
        ),
    ],
)
def test_each_set_of_wheels_is_driven_by_each_controller(in_world, controllers):
    chosen = cases(STANDARD, OMNIMAN, 15.0, 0, in_world=in_world)
    same = [case for case in chosen if (case.group, case.sample) == ("torque", 3)]
    assert [(case.controller, case.gain) for case in same] == controllers
    assert len({case.mismatch for case in same}) == 1
    assert len({case.mismatch for case in chosen if case.group == "P"}) == STANDARD.samples >= 10
    assert (
        cases(STANDARD, OMNIMAN, 15.0, 1)[0].mismatch
        != cases(STANDARD, OMNIMAN, 15.0, 0)[0].mismatch
    )


@pytest.mark.parametrize("name", robots.SHIPPED)
def test_printed_gain_gives_the_correction_of_18_as_printed(name):
    robot = robots.robot(name)
    model = PlatformKinematics(robot.wheels)
    printed = np.sign(model.T_pinv[:, 0]) / robot.wheels.radius[0]  # the last column of (18)
    ours = printed_gain(robots.values(name)) * model.T_pinv[:, 0]
    np.testing.assert_allclose(ours, PAPER_GAIN * printed)


@pytest.mark.parametrize("name", ["mecanum6", "skewed4", "omni3"])
def test_there_is_no_printed_gain_for_wheels_that_18_does_not_describe(name):
    assert printed_gain(robots.values(name)) is None


def test_figures_are_relative_to_the_same_wheels_without_control():
    rows = summary(
        [
            made("P", 0, 0.0, 1.0),
            made("P", 0, 2.0, 0.5),
            made("P", 1, 0.0, 4.0),
            made("P", 1, 2.0, 0.4),
            made("P", 0, 2.0, 0.25, PAPER_CONTROLLER),
        ][:4]
    )
    assert [(row["group"], row["k"]) for row in rows] == [("P", 0.0), ("P", 2.0)]
    assert rows[0]["epsilon_max"] == {"mean": 2.5, "worst": 4.0}
    # 0.5 / 1 and 0.4 / 4.
    assert rows[1]["epsilon_ratio"] == {"mean": pytest.approx(0.3), "worst": pytest.approx(0.5)}
    assert coupling.remaining_ratio(rows, 2.0) == pytest.approx(0.3)


def row(gain, error, energy, controller=LAG_CONTROLLER):
    return {
        "group": "PI",
        "controller": controller,
        "k": gain,
        "epsilon_ratio": {"mean": error if controller == OWN_CONTROLLER else 9.0},
        "error_ratio": {"mean": error if controller == LAG_CONTROLLER else 9.0},
        "energy_ratio": {"mean": energy},
    }


@pytest.mark.parametrize("form", [OWN_CONTROLLER, LAG_CONTROLLER])
def test_a_form_is_judged_at_the_gain_that_leaves_least_within_the_energy(form):
    (other,) = {OWN_CONTROLLER, LAG_CONTROLLER} - {form}
    rows = [row(0.0, 1.0, 1.0, OWN_CONTROLLER), row(15.0, 0.01, 0.5, other)]
    dear = [row(5.0, 0.3, 1.02, form), row(15.0, 0.1, 1.1, form)]
    within = [row(8.0, 0.2, 1.005, form), row(9.0, 0.3, 1.0, form)]
    reached = coupling.world_aim([*rows, *within, *dear], "PI", form)
    assert (reached["k"], reached["error_met"], reached["energy_met"]) == (8.0, True, True)
    reached = coupling.world_aim([*rows, *dear], "PI", form)
    assert (reached["k"], reached["error_met"], reached["energy_met"]) == (5.0, False, False)


def test_the_picture_shows_the_wheels_with_the_median_error(tmp_path):
    figures = pytest.importorskip("omniman_ros.lab.figures")
    runs = [made("P", sample, gain, 1.0 + sample) for sample in range(3) for gain in (0.0, 2.0)]
    assert {run.case.sample for run in figures.select_median(runs)} == {1}
    result = {"chosen_gain": 2.0, "paper_gain": 2.0, "printed_gain": 63.0}
    path = tmp_path / "figure.png"
    figures.draw_coupling(robots.robot(), STANDARD.figure, runs, result, path)
    assert path.read_bytes()[:4] == b"\x89PNG"
