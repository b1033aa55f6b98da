import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.drive.parameters import SimulationParameters
from omniman_ros.studies.scene_generator import Mismatch, RandomScene
from omniman_ros.studies.scene_geometry import Box, Ellipse, Route
from omniman_ros.studies.scenes import (
    LIMIT,
    NEAR,
    Agility,
    SceneDrive,
    agility_of,
    aims,
    box_of,
    groups,
    judged,
    mover_of,
    spread,
    summary,
    true_robot,
)
from omniman_ros.studies.space_time_search import Mover
from test import robots

GOAL = (2.0, 0.0, 0.0)
MOVER = Mover(Box(0.8, 0.5), 1.0, 2.0)
AGILITY = Agility(1.5, 0.15)
SINCE = 0.25
FAR = Ellipse((0.2, 0.2), Route.still(0.0, 3.0))
IN_THE_WAY = Ellipse((0.2, 0.2), Route.still(1.0, 0.1))
CROSSING = Ellipse((0.2, 0.2), Route.straight((5.0, 3.0), (0.1, 0.0)))


def made(*obstacles, **changes):
    scene = RandomScene(0, (0.0, 0.0, 0.0), GOAL, obstacles, None, False, Mismatch())
    return replace(scene, **changes)


def drive(end=GOAL, seconds=4.0, **changes):
    """Straight ahead from the origin."""
    share = np.linspace(0.0, 1.0, 81)
    whole = SceneDrive(
        SINCE + seconds * share, share[:, None] * np.array(end), 50.0, True,
        np.array([0.004, 0.006, 0.008]), 0, 0.001, "arrived", "arrived",
    )  # fmt: skip
    return replace(whole, **changes)


def test_all_that_is_heavy_and_all_friction_is_multiplied():
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


def test_a_robot_like_its_model_is_its_model():
    values, simulation = true_robot(robots.values("ig42"), Mismatch())
    assert values == robots.values("ig42")
    assert build(SimulationParameters, simulation) == build(SimulationParameters, {})


def test_a_factor_that_the_simulation_refuses_is_refused():
    with pytest.raises(ParameterError, match="torque_constant"):
        true_robot(robots.values("ig42"), Mismatch(motor_constant=20.0))


def test_box_and_limits_are_those_of_the_robot():
    values = robots.values("ig42")
    assert box_of(values) == Box(values["body.length"], values["body.width"])
    mover = mover_of(values)
    assert mover.speed == values["limits.linear_velocity"]
    assert mover.yaw_rate == values["limits.angular_velocity"]


# ---- one drive ----------------------------------------------------------------------------------


def test_a_robot_that_comes_through_has_reached_its_goal():
    outcome = judged(made(FAR), drive(), MOVER, AGILITY)
    assert (outcome.reached, outcome.solvable, outcome.own, outcome.failed) == (
        True, True, False, False,
    )  # fmt: skip
    figures = outcome.figures()
    assert figures["time_s"] == pytest.approx(4.0)
    assert figures["off_m"] == pytest.approx(0.0, abs=1e-12)
    assert figures["clearance_m"] == pytest.approx(3.0 - 0.25 - 0.2, abs=1e-3)
    assert figures["answer_median_ms"] == pytest.approx(6.0)
    assert math.isnan(figures["contact_s"])


@pytest.mark.parametrize(
    ("end", "reached"),
    [
        ((2.0 - 0.9 * NEAR[0], 0.0, 0.0), True),
        ((2.0 - 1.1 * NEAR[0], 0.0, 0.0), False),
        ((2.0, 0.0, 0.9 * NEAR[1]), True),
        ((2.0, 0.0, -1.1 * NEAR[1]), False),
        ((2.0, 0.0, math.tau), True),
    ],
)
def test_an_arrival_is_believed_where_it_is_true(end, reached):
    assert judged(made(), drive(end), MOVER, AGILITY).reached is reached


def test_who_does_not_say_that_it_has_arrived_has_not():
    outcome = judged(made(), drive(arrived=False), MOVER, AGILITY)
    assert not outcome.reached
    assert outcome.failed


def test_a_contact_that_could_have_been_avoided_is_the_robots_own():
    outcome = judged(made(IN_THE_WAY), drive(), MOVER, AGILITY)
    assert (outcome.own, outcome.other, outcome.reached) == (True, False, False)
    assert outcome.figures()["touched"] == ["obstacle", 0]
    # 0.4 m before the centre of the robot, a disc of 0.2 m at 1 m.
    assert outcome.figures()["contact_s"] == pytest.approx(2.0 * 0.4, abs=0.02)
    assert outcome.failed


def test_a_contact_that_nobody_could_avoid_is_not(monkeypatch):
    # To search for a way among what is so large takes half a minute, and is not asked here.
    monkeypatch.setattr("omniman_ros.studies.scenes.find_way", lambda *_: None)
    rushing = Ellipse((4.0, 4.0), Route.straight((22.0, 0.0), (-10.0, 0.0)))
    outcome = judged(made(rushing), drive(), MOVER, AGILITY)
    assert (outcome.own, outcome.other, outcome.reached) == (False, True, False)


def turning(time, speed=1.0):
    """A disc that goes along with the robot, 0.5 m beside it, and at a time turns on it."""
    place = (0.5 * (time - SINCE) + 0.3, 0.95)
    begin = (place[0] - 0.5 * time, 0.95)
    return Ellipse((0.2, 0.2), Route((0.0, time), (begin, place), (0.2, -speed)))


@pytest.mark.parametrize(("speed", "surprised"), [(2.5, True), (0.6, False)])
def test_an_obstacle_that_turns_on_the_robot_too_late_is_a_surprise(speed, surprised):
    there = made(turning(1.5, speed))
    outcome = judged(there, drive(), MOVER, AGILITY)
    assert outcome.verdict.collided
    assert outcome.avoidable
    assert (outcome.surprised, outcome.own, outcome.other) == (
        surprised, True, False,
    )  # fmt: skip
    assert not outcome.reached
    # One who reacts at once and accelerates as much as it likes is never surprised.
    assert judged(there, drive(), MOVER, Agility(1e3, 0.0)).own


@pytest.mark.parametrize(("reaction", "surprised"), [(0.0, False), (0.15, True)])
def test_who_sees_a_turn_later_is_surprised_sooner(reaction, surprised):
    outcome = judged(made(turning(1.5, 1.2)), drive(), MOVER, Agility(1.5, reaction))
    assert outcome.surprised is surprised


def test_who_went_straight_all_along_surprises_nobody():
    straight = Ellipse((0.2, 0.2), Route.straight((1.0, 2.9), (0.0, -2.0)))
    outcome = judged(made(straight), drive(), MOVER, Agility(0.0, 1.0))
    assert (outcome.verdict.collided, outcome.surprised) == (True, False)


def test_agility_is_that_of_the_robot():
    assert agility_of(robots.values("ig42"), 0.1) == Agility(1.5, 0.1)
    with pytest.raises(InputError, match="reaction"):
        Agility(1.0, -0.1)


def test_what_cannot_be_reached_is_no_failure():
    there = Ellipse((0.3, 0.3), Route.still(2.0, 0.0))
    outcome = judged(made(there), drive((0.5, 0.0, 0.0), arrived=False), MOVER, AGILITY)
    assert (outcome.solvable, outcome.reached, outcome.failed) == (False, False, False)


def test_to_leave_the_workspace_is_a_failure():
    area = (-1.0, -0.2, 3.0, 1.0)
    outcome = judged(made(workspace=area), drive(), MOVER, AGILITY)
    assert (outcome.left, outcome.failed, outcome.own) == (True, True, False)
    assert outcome.figures()["outside_m"] == pytest.approx(0.05)
    assert not judged(made(workspace=(-1.0, -0.3, 3.0, 1.0)), drive(), MOVER, AGILITY).left


def test_a_way_may_take_as_long_as_a_drive(monkeypatch):
    asked = []
    monkeypatch.setattr(
        "omniman_ros.studies.scenes.find_way", lambda *args: asked.append(args[-2:])
    )
    assert not judged(made(), drive(arrived=False), MOVER, AGILITY).solvable
    assert asked == [(SINCE, SINCE + LIMIT)]


def test_a_drive_without_a_sample_is_refused():
    with pytest.raises(InputError, match="poses"):
        drive(times=np.zeros(0), poses=np.zeros((0, 3)))


# ---- many drives --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def outcomes():
    return [
        judged(made(FAR, seed=1), drive(), MOVER, AGILITY),
        judged(made(CROSSING, seed=2, blocked=True), drive(seconds=6.0, energy=80.0),
               MOVER, AGILITY),
        judged(made(IN_THE_WAY, seed=3, mismatch=Mismatch(1.1)), drive(late=2), MOVER, AGILITY),
        judged(made(Ellipse((0.3, 0.3), Route.still(2.0, 0.0)), seed=4, blocked=True),
               drive((0.3, 0.0, 0.0), arrived=False), MOVER, AGILITY),
    ]  # fmt: skip


def test_groups_are_by_what_makes_a_scene_hard(outcomes):
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


def test_figures_of_many(outcomes):
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
    with pytest.raises(InputError, match="no drive"):
        summary([])


def test_aims_are_no_own_contact_and_nearly_all_that_can_be_reached(outcomes):
    assert aims(summary(outcomes)) == {
        "own_collisions": False, "left_workspace": True, "reached": False,
    }  # fmt: skip
    assert aims(summary(outcomes[:2])) == {
        "own_collisions": True, "left_workspace": True, "reached": True,
    }  # fmt: skip
    assert aims(summary(outcomes[3:]))["reached"] is None
    nearly = [outcomes[0]] * 19
    short = replace(outcomes[3], solvable=True)
    assert aims(summary([*nearly, short]))["reached"] is True
    assert aims(summary([*nearly[1:], short]))["reached"] is False


def test_times_of_no_answer_are_no_number():
    assert all(math.isnan(value) for value in spread(np.zeros(0)).values())
