import math

import numpy as np
import pytest

from omniman_ros.core.parameters import build
from omniman_ros.lab.studies import paper_drive
from omniman_ros.lab.studies.mpc_loop import MotionRecord
from omniman_ros.lab.studies.paper_drive import (
    PACKAGE_WEIGHTS,
    TURNING_WEIGHTS,
    Ground,
    PaperDrive,
    PaperVariant,
    drive_paper,
    driven,
    paper_model,
    paper_variants,
)
from omniman_ros.lab.studies.recorded_drive import Drive
from omniman_ros.planning.parameters import Arrival, Weights
from test import robots

VALUES = robots.values("ig42")
ROBOT = robots.robot("ig42")


BEARING = math.radians(70.0)


def made(turn=0.0, bearing=BEARING):
    """Make a drive of 1 m at 1 m/s that turns at once, then rests for a second."""
    record = MotionRecord()
    for k in range(400):
        time = 0.005 * k
        x = min(time, 1.0)
        pose = np.array([x, 0.0, -bearing + turn * (time > 0.0)])
        direction = -pose[2]
        speed = float(time < 1.0) * (1.0 if k else 0.5)
        record.times.append(time)
        record.poses.append(pose)
        record.odometry.append(pose)
        record.twists.append(speed * np.array([math.cos(direction), math.sin(direction), 0.0]))
        record.energy.append(10.0 * x)
    goal = (6.0, 0.0, -bearing)
    drive = Drive.of(record, 0.0, goal, build(Arrival, {}), np.array([0.4, 0.25]))
    variant = PaperVariant("weights", TURNING_WEIGHTS, bearing=bearing)
    volts = np.tile([24.0, 0.0, 0.0, 24.0], (400, 1))
    volts[100:] = 3.0
    return PaperDrive(variant, drive, volts, 24.0, 20, 0)


def test_figures_hold_until_the_robot_rests():
    figures = made().figures(ROBOT)
    assert figures["rest_s"] == pytest.approx(1.0, abs=0.011)
    assert figures["rest_m"] == pytest.approx(5.0, abs=0.02)
    assert figures["energy_j"] == pytest.approx(10.0, abs=0.1)
    assert figures["saturated_share"] == pytest.approx(0.5, abs=0.02)
    assert figures["way_shares"] == pytest.approx([2 / 9, 3.5 / 9, 7 / 9], abs=0.02)
    assert math.isnan(figures["compared_j"])  # it stops before


@pytest.mark.parametrize(("turn", "share"), [(25.0, 1.0), (-20.0, 0.0)])
def test_turn_is_positive_towards_the_nearest_diagonal(turn, share):
    figures = made(math.radians(turn)).figures(ROBOT)
    assert figures["turn_to_diagonal_rad"] == pytest.approx(math.radians(turn))
    assert figures["from_diagonal_at_peak_rad"] == pytest.approx(
        math.radians(25.0 - turn), abs=1e-6
    )
    assert figures["share"] == pytest.approx(share, abs=0.01)


def test_package_weights_are_those_of_the_planner():
    weights = build(Weights, {})
    assert (weights.position, weights.heading) == (
        PACKAGE_WEIGHTS.position,
        PACKAGE_WEIGHTS.heading,
    )


def test_each_variant_differs_and_the_first_two_are_the_weights_compared():
    variants = paper_variants(VALUES)
    assert [v.weights for v in variants[:2]] == [PACKAGE_WEIGHTS, TURNING_WEIGHTS]
    names = [(v.about, v.weights) for v in variants]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("ground", list(Ground))
def test_equal_forward_voltages_drive_forwards_on_every_ground(ground):
    body = driven(PaperVariant("", TURNING_WEIGHTS, ground=ground), VALUES, (0.0, 0.0, 0.0))
    for _ in range(40):
        body.apply(np.full(4, 6.0))
    x, y, heading = body.state[:3]
    assert 0.02 < x < 0.1
    assert abs(y) < 1e-3
    assert abs(heading) < 1e-3
    assert body.energy > 1.0


def test_model_of_the_paper_has_no_roller_drag():
    assert np.all(paper_model(VALUES).drag == 0.0)


def test_drive_ends_at_the_time_limit(monkeypatch):
    monkeypatch.setattr(paper_drive, "TIME_LIMIT", 0.2)
    drive = drive_paper(VALUES, PaperVariant("", TURNING_WEIGHTS, ground=Ground.MODEL))
    assert drive.stages == 2
    assert len(drive.drive.times) == 40


@pytest.mark.exhaustive
def test_weights_decide_whether_the_robot_turns_to_a_diagonal():
    found = [
        drive_paper(VALUES, PaperVariant("weights", weights)).figures(ROBOT)
        for weights in (PACKAGE_WEIGHTS, TURNING_WEIGHTS)
    ]
    saturated, turning = found
    for figures in found:
        assert figures["unsolved"] == 0
        assert figures["peak_speed_s"] < 0.5 * figures["rest_s"]
        assert 1.0 - figures["way_shares"][-1] < 0.1
    assert math.degrees(turning["turn_to_diagonal_rad"]) > 15.0
    assert turning["share"] > 0.8
    assert turning["rest_m"] > 0.3
    assert math.degrees(saturated["turn_to_diagonal_rad"]) < -10.0
    assert saturated["share"] < 0.2
    assert saturated["rest_m"] < 0.1


@pytest.mark.exhaustive
def test_without_coulomb_friction_it_does_not_turn():
    variants = [v for v in paper_variants(VALUES) if v.about == "no Coulomb friction"]
    drive = drive_paper(VALUES, next(v for v in variants if v.weights == TURNING_WEIGHTS))
    assert math.degrees(drive.figures(ROBOT)["peak_turn_rad"]) < 3.0
