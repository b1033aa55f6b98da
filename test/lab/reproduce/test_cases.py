"""The cases of MPC 2021 and the workshop: what is judged, and the drives' own judge."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from omniman_ros.cli.main import main
from omniman_ros.core.parameters import build
from omniman_ros.lab.reproduce import cases
from omniman_ros.lab.studies.closed_loop import MotionRecord, StudyError
from omniman_ros.lab.studies.mpc_cases import SCENES, MpcCase, circle
from omniman_ros.lab.studies.planned_drives import SETTLING_TIME, RecordedDrive, drive_with_planner
from omniman_ros.lab.studies.scene_geometry import RectangularOutline
from omniman_ros.planning.cases import RADIUS, TwoVelocityPath
from omniman_ros.planning.parameters import Arrival
from test import robots

BOX = RectangularOutline(0.8, 0.5)
SHORT = MpcCase("corridor", (0.3, 0.0, 0.0), obstacles=(circle(0.3, TwoVelocityPath((0.2, 0.9))),))


def driven(xs, obstacles=(), goal=(1.0, 0.0, 0.0), since=0.0):
    """Return a drive along x with a position each 5 ms, which consumes 10 J per second."""
    record = MotionRecord()
    for k, x in enumerate(xs):
        record.times.append(0.005 * k)
        record.poses.append(np.array([x, 0.0, 0.0]))
        record.odometry.append(np.array([x, 0.0, 0.0]))
        record.twists.append(np.array([(x - xs[k - 1]) / 0.005 if k else 0.0, 0.0, 0.0]))
        record.energy.append(5.0 + 0.05 * k)
    return RecordedDrive.of(record, since, goal, build(Arrival, {}), BOX, obstacles)


def there_and_rest(seconds=1.0, rest=1.0):
    ahead = np.linspace(0, 1, round(seconds / 0.005))
    return np.concatenate([ahead, np.ones(round(rest / 0.005))])


@pytest.mark.parametrize(("x", "gap"), [(1.71, 0.01), (1.69, -0.01)])
def test_contact_at_the_end_of_the_path_is_found_to_the_centimetre(x, gap):
    drive = driven(there_and_rest(), [circle(0.3, TwoVelocityPath((x, 0.0)))])
    assert drive.clearance == pytest.approx(gap, abs=1e-6)
    assert drive.collided is (gap < 0.0)


def test_fast_circle_that_crosses_a_standing_robot_is_a_contact():
    crossing = circle(0.05, TwoVelocityPath((0.0, -5.0), (0.0, 8.0)))
    assert driven(np.zeros(400), [crossing], goal=(0.0, 0.0, 0.0)).collided
    # No contact off its path: 0.1 m beyond the front of the box.
    missing = circle(0.05, TwoVelocityPath((0.55, -5.0), (0.0, 8.0)))
    assert driven(np.zeros(400), [missing]).clearance == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize("gap", [0.0, math.nan, -math.inf])
def test_gap_that_is_not_above_zero_is_a_contact(gap):
    assert replace(driven(np.zeros(2)), gaps=np.array([[0.5], [gap]])).collided
    assert not driven(np.zeros(2)).collided


def test_arrival_is_when_the_robot_first_rests_at_its_goal_for_good():
    assert driven(there_and_rest(1.0)).arrival == pytest.approx(1.0, abs=0.006)
    left = np.concatenate([there_and_rest(1.0, 1.0), np.full(100, 0.9), np.ones(100)])
    assert driven(left).arrival > 2.4
    assert driven(np.append(left, [0.9, 0.9])).arrival == math.inf
    assert driven(np.linspace(0.0, 1.0, 200)).arrival == math.inf, "it drives through"
    assert driven(there_and_rest(), since=0.5).arrival == pytest.approx(0.5, abs=0.006)


def test_energy_counts_until_half_a_second_after_arrival():
    drive = driven(there_and_rest(1.0, 2.0))
    assert drive.energy_until_rest() == pytest.approx(10.0 * (drive.arrival + SETTLING_TIME))
    with pytest.raises(StudyError, match="until rest"):
        driven(there_and_rest(1.0, 0.3)).energy_until_rest()


def test_gaps_of_the_corridor_are_wider_than_the_robot_and_shorter():
    places = np.array([o.place(0.0) for o in SCENES["corridor"]().obstacles])
    gaps = np.hypot(*np.diff(places, axis=0).T) - 2 * RADIUS
    assert (gaps > BOX.width + 0.1).all() and (gaps < BOX.length).all()


@pytest.fixture(scope="module")
def ride():
    """Return a drive of 0.3 m past a circle."""
    ticks = iter(range(10**6))
    values = robots.values("ig42")
    return drive_with_planner(values, SHORT, {}, False, 0, lambda: 1e-3 * next(ticks), None)


@pytest.fixture
def case(monkeypatch, tmp_path, ride):
    """Run a case in which every drive is the short one, spoiled by a function of its number."""

    def run(spoil=lambda ride, number: ride, name="corridor"):
        asked = []

        def drive(robot, scene, changes, voltages, *_):
            asked.append((dict(changes), voltages))
            return spoil(ride, len(asked))

        monkeypatch.setattr(cases, "drive_with_planner", drive)
        monkeypatch.setitem(cases.SCENES, name, lambda: replace(SHORT, name=name))
        code = main(["reproduce", name, "--results", str(tmp_path)])
        return code, json.loads((tmp_path / f"reproduce_{name}.json").read_text()), asked

    return run


def collided(ride, number=0):
    return replace(ride, drive=replace(ride.drive, gaps=ride.drive.gaps - 0.7))


def test_a_case_is_driven_with_both_outputs_and_with_the_papers_horizon(case, capsys):
    code, result, asked = case()
    assert code == 0
    assert asked == [({}, False), ({}, True), (dict(cases.PAPER_HORIZON), False)]
    first = result["drives"][0]
    assert first["reached"] and not first["collided"]
    assert first["clearance_m"] == pytest.approx(0.35, abs=0.02)
    assert first["cpu_median_ms"] == pytest.approx(2.0)
    assert first["plans_used"] <= first["cycles"]
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == result


@pytest.mark.parametrize(
    "spoil",
    [collided, lambda ride, _: replace(ride, drive=replace(ride.drive, goal=(9.0, 0.0, 0.0)))],
)
def test_contact_or_unreached_goal_is_a_failure(case, spoil, capsys):
    code, result, _ = case(spoil)
    assert (code, result["passed"]) == (1, False)
    assert "FAILED" in capsys.readouterr().out


def test_contact_with_changed_parameters_is_not_a_failure(case, capsys):
    code, result, _ = case(lambda ride, number: collided(ride) if number == 3 else ride)
    assert code == 0
    assert [row["collided"] for row in result["drives"]] == [False, False, True]
    assert "CONTACT" in capsys.readouterr().out


def test_the_workshop_is_driven_by_both_outputs_and_drawn_with_its_map(case):
    pytest.importorskip("matplotlib")
    code, result, asked = case(name="workshop")
    assert (code, [voltages for _, voltages in asked]) == (0, [False, True])
    assert Path(result["picture"]).read_bytes()[:4] == b"\x89PNG"
