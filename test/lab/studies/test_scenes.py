import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.scene_generator import Mismatch, RandomScene
from omniman_ros.lab.studies.scene_geometry import Box, Ellipse, PolylineMotion
from omniman_ros.lab.studies.scenes import (
    GOAL_TOLERANCE,
    TIME_LIMIT,
    Agility,
    SceneDrive,
    agility_of,
    aims,
    answer_statistics,
    box_of,
    groups,
    judge_drive,
    mover_of,
    summary,
    true_robot,
)
from omniman_ros.lab.studies.space_time_grid import Mover
from omniman_ros.simulation.plant.parameters import SimulationParameters
from test import robots

GOAL = (2.0, 0.0, 0.0)
MOVER = Mover(Box(0.8, 0.5), 1.0, 2.0)
AGILITY = Agility(1.5, 0.15)
SINCE = 0.25
FAR = Ellipse((0.2, 0.2), PolylineMotion.still(0.0, 3.0))
IN_THE_WAY = Ellipse((0.2, 0.2), PolylineMotion.still(1.0, 0.1))
CROSSING = Ellipse((0.2, 0.2), PolylineMotion.straight((5.0, 3.0), (0.1, 0.0)))


def made(*obstacles, **changes):
    scene = RandomScene(0, (0.0, 0.0, 0.0), GOAL, obstacles, None, False, Mismatch())
    return replace(scene, **changes)


def drive(end=GOAL, seconds=4.0, **changes):
    """Return a drive straight ahead from the origin."""
    share = np.linspace(0.0, 1.0, 81)
    whole = SceneDrive(
        SINCE + seconds * share,
        share[:, None] * np.array(end),
        50.0,
        True,
        np.array([0.004, 0.006, 0.008]),
        0,
        0.001,
        "arrived",
        "arrived",
    )
    return replace(whole, **changes)


def test_mass_inertia_and_friction_are_scaled():
    robot = robots.values("omniman")
    values, simulation = true_robot(robot, Mismatch(1.2, 0.8, 1.1))
    true, known = build(Robot, values), build(Robot, robot)
    assert true.body.mass == pytest.approx(1.2 * known.body.mass)
    assert true.body.inertia == pytest.approx(1.2 * known.body.inertia)
    assert true.arm.mass == pytest.approx(1.2 * known.arm.mass)
    assert true.arm.inertia == pytest.approx(1.2 * known.arm.inertia)
    assert true.friction.roller == pytest.approx([0.8 * f for f in known.friction.roller])
    assert true.friction.coulomb == known.friction.coulomb  # the simulation multiplies it
    plant = build(SimulationParameters, simulation).mismatch
    assert (plant.friction, plant.torque_constant) == ((0.8,), (1.1,))
    assert robot == robots.values("omniman")


def test_robot_with_unit_factors_equals_its_model():
    values, simulation = true_robot(robots.values("ig42"), Mismatch())
    assert values == robots.values("ig42")
    assert build(SimulationParameters, simulation) == build(SimulationParameters, {})


def test_factor_that_the_simulation_refuses_is_refused():
    with pytest.raises(ParameterError, match="torque_constant"):
        true_robot(robots.values("ig42"), Mismatch(motor_constant=20.0))


def test_box_and_limits_are_taken_from_the_robot():
    values = robots.values("ig42")
    assert box_of(values) == Box(values["body.length"], values["body.width"])
    mover = mover_of(values)
    assert mover.speed == values["limits.linear_velocity"]
    assert mover.yaw_rate == values["limits.angular_velocity"]


# ---- one drive ----------------------------------------------------------------------------------


def test_robot_that_passes_the_scene_has_reached_its_goal():
    outcome = judge_drive(made(FAR), drive(), MOVER, AGILITY)
    assert (outcome.reached, outcome.solvable, outcome.at_fault, outcome.failed) == (
        True,
        True,
        False,
        False,
    )
    figures = outcome.figures()
    assert figures["time_s"] == pytest.approx(4.0)
    assert figures["off_m"] == pytest.approx(0.0, abs=1e-12)
    assert figures["clearance_m"] == pytest.approx(3.0 - 0.25 - 0.2, abs=1e-3)
    assert figures["answer_median_ms"] == pytest.approx(6.0)
    assert math.isnan(figures["contact_s"])


@pytest.mark.parametrize(
    ("end", "reached"),
    [
        ((2.0 - 0.9 * GOAL_TOLERANCE[0], 0.0, 0.0), True),
        ((2.0 - 1.1 * GOAL_TOLERANCE[0], 0.0, 0.0), False),
        ((2.0, 0.0, 0.9 * GOAL_TOLERANCE[1]), True),
        ((2.0, 0.0, -1.1 * GOAL_TOLERANCE[1]), False),
        ((2.0, 0.0, math.tau), True),
    ],
)
def test_reported_arrival_counts_only_if_true(end, reached):
    assert judge_drive(made(), drive(end), MOVER, AGILITY).reached is reached


def test_unreported_arrival_does_not_count():
    outcome = judge_drive(made(), drive(arrived=False), MOVER, AGILITY)
    assert not outcome.reached
    assert outcome.failed


def test_avoidable_contact_is_the_fault_of_the_robot():
    outcome = judge_drive(made(IN_THE_WAY), drive(), MOVER, AGILITY)
    assert (outcome.at_fault, outcome.inevitable_contact, outcome.reached) == (True, False, False)
    assert outcome.figures()["touched"] == ["obstacle", 0]
    # The front is 0.4 m before the centre of the robot; a disc of 0.2 m is at 1 m.
    assert outcome.figures()["contact_s"] == pytest.approx(2.0 * 0.4, abs=0.02)
    assert outcome.failed


@pytest.mark.exhaustive
def test_unavoidable_contact_is_not_the_fault_of_the_robot(monkeypatch):
    # A search among such large obstacles takes half a minute and is not tested here.
    monkeypatch.setattr("omniman_ros.lab.studies.scenes.find_path", lambda *_: None)
    rushing = Ellipse((4.0, 4.0), PolylineMotion.straight((22.0, 0.0), (-10.0, 0.0)))
    outcome = judge_drive(made(rushing), drive(), MOVER, AGILITY)
    assert (outcome.at_fault, outcome.inevitable_contact, outcome.reached) == (False, True, False)


def turning(time, speed=1.0):
    """Return a disc that moves 0.5 m beside the robot and turns towards it at a given time."""
    place = (0.5 * (time - SINCE) + 0.3, 0.95)
    begin = (place[0] - 0.5 * time, 0.95)
    return Ellipse((0.2, 0.2), PolylineMotion((0.0, time), (begin, place), (0.2, -speed)))


@pytest.mark.parametrize(("speed", "surprised"), [(2.5, True), (0.6, False)])
def test_obstacle_that_turns_towards_the_robot_too_late_is_a_surprise(speed, surprised):
    there = made(turning(1.5, speed))
    outcome = judge_drive(there, drive(), MOVER, AGILITY)
    assert outcome.verdict.collided
    assert outcome.avoidable
    assert (outcome.surprised, outcome.at_fault, outcome.inevitable_contact) == (
        surprised,
        True,
        False,
    )
    assert not outcome.reached
    # A robot of unlimited reaction and acceleration is never surprised.
    assert judge_drive(there, drive(), MOVER, Agility(1e3, 0.0)).at_fault


@pytest.mark.parametrize(("reaction", "surprised"), [(0.0, False), (0.15, True)])
def test_longer_reaction_time_makes_surprise_more_likely(reaction, surprised):
    outcome = judge_drive(made(turning(1.5, 1.2)), drive(), MOVER, Agility(1.5, reaction))
    assert outcome.surprised is surprised


def test_obstacle_that_always_moved_straight_is_no_surprise():
    straight = Ellipse((0.2, 0.2), PolylineMotion.straight((1.0, 2.9), (0.0, -2.0)))
    outcome = judge_drive(made(straight), drive(), MOVER, Agility(0.0, 1.0))
    assert (outcome.verdict.collided, outcome.surprised) == (True, False)


def test_agility_is_taken_from_the_robot():
    assert agility_of(robots.values("ig42"), 0.1) == Agility(1.5, 0.1)
    with pytest.raises(InputError, match="reaction"):
        Agility(1.0, -0.1)


def test_unreachable_goal_is_not_a_failure():
    there = Ellipse((0.3, 0.3), PolylineMotion.still(2.0, 0.0))
    outcome = judge_drive(made(there), drive((0.5, 0.0, 0.0), arrived=False), MOVER, AGILITY)
    assert (outcome.solvable, outcome.reached, outcome.failed) == (False, False, False)


def test_leaving_the_workspace_is_a_failure():
    area = (-1.0, -0.2, 3.0, 1.0)
    outcome = judge_drive(made(workspace=area), drive(), MOVER, AGILITY)
    assert (outcome.left_workspace, outcome.failed, outcome.at_fault) == (True, True, False)
    assert outcome.figures()["outside_m"] == pytest.approx(0.05)
    assert not judge_drive(
        made(workspace=(-1.0, -0.3, 3.0, 1.0)), drive(), MOVER, AGILITY
    ).left_workspace


def test_reference_path_may_take_as_long_as_a_drive(monkeypatch):
    asked = []
    monkeypatch.setattr(
        "omniman_ros.lab.studies.scenes.find_path", lambda *args: asked.append(args[-2:])
    )
    assert not judge_drive(made(), drive(arrived=False), MOVER, AGILITY).solvable
    assert asked == [(SINCE, SINCE + TIME_LIMIT)]


def test_drive_without_a_sample_is_refused():
    with pytest.raises(InputError, match="poses"):
        drive(times=np.zeros(0), poses=np.zeros((0, 3)))


# ---- many drives --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def outcomes():
    return [
        judge_drive(made(FAR, seed=1), drive(), MOVER, AGILITY),
        judge_drive(
            made(CROSSING, seed=2, blocked=True), drive(seconds=6.0, energy=80.0), MOVER, AGILITY
        ),
        judge_drive(
            made(IN_THE_WAY, seed=3, mismatch=Mismatch(1.1)), drive(late=2), MOVER, AGILITY
        ),
        judge_drive(
            made(Ellipse((0.3, 0.3), PolylineMotion.still(2.0, 0.0)), seed=4, blocked=True),
            drive((0.3, 0.0, 0.0), arrived=False),
            MOVER,
            AGILITY,
        ),
    ]


def test_scenes_are_grouped_by_difficulty(outcomes):
    seeds = {name: [o.scene.seed for o in members] for name, members in groups(outcomes).items()}
    assert seeds == {
        "all": [1, 2, 3, 4],
        "line blocked": [2, 4],
        "line free": [1, 3],
        "model off by up to 20 %": [3],
        "model exact": [1, 2, 4],
        "moving obstacles": [2],
        "fixed obstacles only": [1, 3, 4],
    }
    assert "moving obstacles" not in groups(outcomes[:1])


def test_figures_summarise_many_drives(outcomes):
    whole = summary(outcomes)
    assert whole["drives"] == 4
    assert whole["own_collisions"] == 1
    assert whole["other_collisions"] == 0
    assert whole["solvable"] == 3
    assert whole["reached"] == 2
    assert whole["reached_share"] == pytest.approx(0.5)
    assert whole["reached_of_solvable"] == pytest.approx(2 / 3)
    assert whole["time_median_s"] == pytest.approx(5.0)
    assert whole["time_max_s"] == pytest.approx(6.0)
    assert whole["energy_sum_j"] == pytest.approx(130.0)
    touched_nothing = [o.verdict.gap for k, o in enumerate(outcomes) if k != 2]
    assert whole["least_clearance_m"] == min(touched_nothing)
    assert whole["clearance_median_m"] == np.median(touched_nothing)
    assert math.isnan(summary(outcomes[2:3])["least_clearance_m"])
    assert (whole["late"], whole["cycles"]) == (2, 12)
    assert whole["answer_max_ms"] == pytest.approx(8.0)
    with pytest.raises(InputError, match="no drive to"):
        summary([])


def test_aims_are_no_avoidable_contact_and_nearly_every_reachable_goal(outcomes):
    assert aims(summary(outcomes)) == {
        "own_collisions": False,
        "left_workspace": True,
        "reached": False,
    }
    assert aims(summary(outcomes[:2])) == {
        "own_collisions": True,
        "left_workspace": True,
        "reached": True,
    }
    assert aims(summary(outcomes[3:]))["reached"] is None
    nearly = [outcomes[0]] * 49
    short = replace(outcomes[3], solvable=True)
    assert aims(summary([*nearly, short]))["reached"] is True
    assert aims(summary([*nearly[1:], short]))["reached"] is False


def test_solve_times_without_solutions_are_nan():
    assert all(math.isnan(value) for value in answer_statistics(np.zeros(0)).values())
