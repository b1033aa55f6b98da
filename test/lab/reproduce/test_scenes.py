"""Scenes: callbacks of the node in simulated time, and the report of the command."""

import argparse
import importlib.util
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.console.errors import CommandError
from omniman_ros.core.errors import ParameterError
from omniman_ros.lab.reproduce import scenes
from omniman_ros.lab.reproduce.scene_runs import NodeLoop, SceneRunSettings, drive_scene
from omniman_ros.lab.studies.scene_generator import Mismatch, RandomScene, SceneError
from omniman_ros.lab.studies.scene_geometry import Ellipse, PolylineMotion, RectangularOutline
from omniman_ros.lab.studies.scenes import (
    AIM_REACHED,
    GOAL_TOLERANCE,
    SceneDrive,
    aims,
    groups,
    judge_drive,
    summary,
    true_robot,
)
from omniman_ros.lab.sweep import Sweep
from omniman_ros.planning.cycle import PlannerState
from test import robots
from test.tiers import exhaustive

IN_WORLD = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="needs mujoco")
CYCLE, DEADLINE = 0.05, 0.04
MOVING = Ellipse((0.2, 0.3), PolylineMotion.straight((2.0, 2.5), (0.3, 0.0)), 0.4)
STANDING = Ellipse((0.2, 0.2), PolylineMotion.still(1.5, 1.2))


def made(*obstacles, **changes):
    scene = RandomScene(5, (0.0, 0.0, 0.0), (2.0, 0.0, 0.5), obstacles, None, False, Mismatch())
    return replace(scene, **changes)


@pytest.fixture
def loop_in():
    """Yield a maker of loops whose nodes are destroyed at the end."""
    loops = []

    def make(there, **options):
        loops.append(NodeLoop(there, SceneRunSettings(**options)))
        return loops[-1]

    yield make
    for loop in loops:
        loop.close()


# ---- the node in its loop -----------------------------------------------------------------------


@pytest.mark.parametrize(("seed", "solve_time"), [exhaustive(20, 0.005), exhaustive(97, 0.01)])
def test_robot_flees_from_an_obstacle_that_turns_towards_the_robot(seed, solve_time):
    """If braking and fleeing alternated, the robot would stay and be hit."""
    outcome = drive_scene(SceneRunSettings(solve_time=solve_time), seed)
    assert not outcome.verdict.collided and outcome.reached


@pytest.mark.parametrize("solve_time", [0.01, exhaustive(0.02)])
def test_solution_reaches_the_controller_after_its_solve_time(loop_in, solve_time):
    loop = loop_in(made(), solve_time=solve_time)
    heard, ticks = [], []
    controller, tick = loop.loop.controller, loop.node.tick
    hear = controller.set_preview
    loop.node.tick = lambda: (ticks.append(loop.now), tick())
    controller.set_preview = lambda s, p, now: (heard.append(now), hear(s, p, now))[1]
    loop.run(1.0)
    planned = [at for at in ticks if at > 0.26]
    assert len(heard) > 15
    assert heard == pytest.approx([at + solve_time for at in planned[: len(heard)]], abs=1e-9)
    assert np.diff(planned) == pytest.approx(CYCLE, abs=1e-9)


def test_arrival_ends_the_drive(loop_in):
    loop = loop_in(made(goal=(0.3, 0.0, 0.0)), solve_time=0.01)
    states, tick = [], loop.node.tick
    loop.node.tick = lambda: (tick(), states.append(loop.node.core.state))
    drive = loop.run(10.0)
    assert states.count(PlannerState.ARRIVED) == 1
    assert drive.arrived
    assert loop.node.core.state is PlannerState.ARRIVED
    assert drive.times[0] == pytest.approx(0.25)
    assert 0.3 < drive.times[-1] < 4.0
    assert np.hypot(*(drive.poses[-1] - (0.3, 0.0, 0.0))[:2]) < 0.03


# ---- the command --------------------------------------------------------------------------------


def args(tmp_path=None, **given):
    values = {
        "name": "scenes",
        "robot": "ig42",
        "seed": 0,
        "quick": False,
        "full": False,
        "seeds": None,
        "jobs": 1,
        "dask": None,
        "sense": "markers",
        "solve_time": None,
        "world": None,
        "results": str(tmp_path),
    }
    return argparse.Namespace(**(values | given))


@pytest.mark.parametrize(
    ("given", "seeds"),
    [
        ({}, range(240)),
        ({"quick": True}, range(8)),
        ({"full": True}, range(1000)),
        ({"seeds": "17"}, range(17, 18)),
        ({"seeds": "5:9"}, range(5, 9)),
    ],
)
def test_seeds_are_selected_by_options(given, seeds):
    assert scenes.scene_seeds(args(**given)) == seeds


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"seeds": "9:5"}, "9:5"),
        ({"seeds": "-3:5"}, "-3:5"),
        ({"seeds": "a"}, "'a'"),
        ({"jobs": 0}, "--jobs"),
        ({"solve_time": 2.0}, "--solve-time"),
        ({"solve_time": math.nan}, "--solve-time"),
    ],
)
def test_usage_error_is_reported(monkeypatch, given, said):
    monkeypatch.setattr(Sweep, "map", lambda *_: pytest.fail("drives"))
    with pytest.raises(CommandError, match=said) as error:
        scenes.run(args(**given))
    assert error.value.code == 2


def outcome(seed, end=(2.0, 0.0, 0.5), obstacles=(), arrived=True):
    """Return the outcome of a synthetic straight drive."""
    there = made(*obstacles, seed=seed, blocked=bool(seed % 2))
    fraction = np.linspace(0.0, 1.0, 81)
    drive = SceneDrive(
        0.25 + 4.0 * fraction,
        fraction[:, None] * np.array(end),
        60.0,
        arrived,
        np.full(80, 0.006),
        0,
        0.001,
        "arrived" if arrived else "blocked",
        "arrived" if arrived else "blocked: no way",
    )
    return judge_drive(there, drive, RectangularOutline(0.8, 0.5))


def command(monkeypatch, tmp_path, outcomes, **given):
    asked = []

    def driven(sweep, function, seeds):
        asked.append((*function.args, list(seeds), sweep.jobs))
        yield from outcomes

    monkeypatch.setattr(Sweep, "map", driven)
    code = scenes.run(args(tmp_path, seeds=f"0:{len(outcomes)}", **given))
    return code, json.loads((tmp_path / "reproduce_scenes.json").read_text()), asked


def test_met_aims_are_reported(monkeypatch, tmp_path, capsys):
    there = (MOVING, Ellipse((0.3, 0.3), PolylineMotion.still(-2.0, 2.0)))
    outcomes = [outcome(k, obstacles=there[k % 2 :]) for k in range(4)]
    code, result, asked = command(monkeypatch, tmp_path, outcomes, seed=7, solve_time=0.02)
    assert code == 0
    assert asked == [(SceneRunSettings("ig42", 7, 0.02), [0, 1, 2, 3], 1)]
    assert result["passed"] is True
    assert result["failed"] == []
    assert [row["seed"] for row in result["drives"]] == [0, 1, 2, 3]
    assert result["groups"]["line blocked"]["drives"] == 2
    text = capsys.readouterr().out
    assert text.count("  met\n") == 3
    assert "MISSED" not in text
    assert json.loads(text.splitlines()[-1]) == result


def test_missed_aims_are_reported_with_the_failed_seeds(monkeypatch, tmp_path, capsys):
    wall = Ellipse((0.2, 0.2), PolylineMotion.still(1.0, 0.1))
    outcomes = [outcome(0), outcome(1, obstacles=(wall,)), outcome(2, (1.0, 0.0, 0.0), (), False)]
    code, result, _ = command(monkeypatch, tmp_path, outcomes)
    assert code == 1
    assert result["aims"] == {"contacts": False, "left_workspace": True, "reached_share": False}
    assert result["failed"] == [1, 2]
    text = capsys.readouterr().out
    assert "MISSED" in text
    assert "seed 1, touched obstacle 1 after" in text
    assert "seed 2, 1.00 m from the goal after 4.0 s, blocked: no way" in text
    assert "seed 0," not in text


def test_seed_without_a_scene_is_reported(monkeypatch, tmp_path):
    def driven(*_):
        raise SceneError("no scene was found for seed 9")
        yield

    monkeypatch.setattr(Sweep, "map", driven)
    with pytest.raises(CommandError, match="seed 9"):
        scenes.run(args(tmp_path, seeds="0"))


@IN_WORLD
def test_in_the_world_a_contact_by_the_engine_counts(loop_in):
    """The front of ig42 is 0.4 m ahead of base_link; the obstacle drives into it."""
    chaser = Ellipse((0.2, 0.1), PolylineMotion.straight((0.75, 0.0), (-0.5, 0.0)))
    loop = loop_in(made(STANDING, chaser), wheels="ideal")
    while loop.touched is None and loop.now < 0.6:
        loop.step()
    when, index = loop.touched
    assert index == 1
    assert when == pytest.approx(0.15 / 0.5, abs=0.02)
    drive = SceneDrive(
        np.array([0.0, 0.4]), np.zeros((2, 3)), 1.0, True, np.array([0.01]), 0, 0.0, "", ""
    )
    there, box = made(STANDING), RectangularOutline(0.8, 0.5)
    assert not judge_drive(there, drive, box).verdict.collided
    verdict = judge_drive(there, replace(drive, touched=(0.2, 0)), box).verdict
    assert (verdict.contact, verdict.touched) == (0.2, 0)


@IN_WORLD
def test_scanners_take_the_place_of_markers(loop_in):
    pytest.importorskip("scipy")
    walker = Ellipse((0.25, 0.25), PolylineMotion.straight((3.0, 1.5), (0.0, -0.8)))
    loop = loop_in(made(STANDING, walker), wheels="ideal", by_scanner=True)
    while loop.now < 1.5:
        loop.step()
    seen = loop.node.inputs.surroundings.obstacles.ellipses()
    (center,), (velocity,) = seen.centers, seen.velocities
    assert center == pytest.approx((3.0, 1.5 - 0.8 * loop.now), abs=0.1)
    assert velocity == pytest.approx((0.0, -0.8), abs=0.15)
    standing, _ = loop.node.core.grid.obstacles()
    off = np.hypot(*(standing - (1.5, 1.2)).T)
    assert len(off) > 3 and (np.abs(off - 0.2) < 0.1).all()


# ---- what decides the aims ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("end", "reached"),
    [
        ((2.0 - 0.9 * GOAL_TOLERANCE[0], 0.0, 0.5), True),
        ((2.0 - 1.1 * GOAL_TOLERANCE[0], 0.0, 0.5), False),
        ((2.0, 0.0, 0.5 + 0.9 * GOAL_TOLERANCE[1]), True),
        ((2.0, 0.0, 0.5 - 1.1 * GOAL_TOLERANCE[1]), False),
        ((2.0, 0.0, 0.5 + math.tau), True),
    ],
)
def test_reported_arrival_counts_only_if_true(end, reached):
    assert outcome(0, end).reached is reached
    assert not outcome(0, end, arrived=False).reached


def test_leaving_the_workspace_is_a_failure():
    for low, left in ((-0.2, True), (-0.5, False)):
        there = replace(made(), workspace=(-1.0, low, 3.0, 1.0))
        judged = judge_drive(there, outcome(0).drive, RectangularOutline(0.8, 0.5))
        assert (judged.left_workspace, judged.failed) == (left, left)


def test_aims_are_no_contact_and_nearly_every_goal():
    wall = Ellipse((0.2, 0.2), PolylineMotion.still(1.0, 0.1))
    good, hit = outcome(0), outcome(1, obstacles=(wall,))
    whole = summary([good, hit])
    assert (whole["drives"], whole["contacts"], whole["reached"]) == (2, 1, 1)
    assert aims(whole) == {"contacts": False, "left_workspace": True, "reached_share": False}
    short = outcome(2, (1.0, 0.0, 0.0), (), False)
    assert aims(summary([good] * 49 + [short]))["reached_share"] is (AIM_REACHED <= 49 / 50)
    assert aims(summary([good] * 48 + [short]))["reached_share"] is False
    assert {name: len(each) for name, each in groups([good, hit]).items()} == {
        "all": 2,
        "line blocked": 1,
    }


def test_mass_inertia_and_friction_of_the_true_robot_are_scaled():
    robot = robots.values("omniman")
    values, simulation = true_robot(robot, Mismatch(1.2, 0.8, 1.1))
    assert values["body.mass"] == pytest.approx(1.2 * robot["body.mass"])
    assert values["friction.roller"] == pytest.approx([0.8 * f for f in robot["friction.roller"]])
    assert simulation == {"mismatch.friction": (0.8,), "mismatch.torque_constant": (1.1,)}
    assert true_robot(robot, Mismatch())[0] == robot
    with pytest.raises(ParameterError, match="torque_constant"):
        true_robot(robot, Mismatch(motor_constant=20.0))
