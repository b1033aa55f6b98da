"""The report of `omniman status`, from words of nodes."""

from dataclasses import replace

import pytest

from omniman_ros.cli.status_report import (
    FREE,
    LIMITED,
    NO_ODOM,
    RELEASES,
    SILENCE,
    UNCOMMANDED,
    RobotWords,
    Trouble,
    Words,
    report,
)
from omniman_ros.core.arbiter import Source

CONTROLLER, DRIVE, PLANNER = "/platform_controller", "/simulated_drive", "/mpc_planner"
RESET = RELEASES[Trouble.STOPPED].format(of="")


def stop(state, reason="", ending=False):
    values = {"state": state, "reason": reason, "ending": str(ending)}
    return Words(("running", "holding", "stopped").index(state), f"{state}: {reason}", values)


def diagnostics(level=0, text="running", age=0.1, **values):
    return Words(level, text, values, age)


def healthy(**changes):
    robot = RobotWords(
        nodes=frozenset({CONTROLLER, DRIVE}),
        movers=frozenset({CONTROLLER, DRIVE}),
        stops={CONTROLLER: stop("running"), DRIVE: stop("running")},
        diagnostics={
            CONTROLLER: diagnostics(motion_limit="1.0"),
            DRIVE: diagnostics(ramping_to_rest_by_itself="False"),
        },
        source="none",
        pose=(1.0, -0.5, 0.0),
        pose_age=0.02,
        speed=(0.0, 0.0),
        stands=True,
    )
    return replace(robot, **changes)


def with_words(robot, name, words):
    return replace(robot, diagnostics={**robot.diagnostics, name: words})


def with_stop(robot, name, words):
    return replace(robot, stops={**robot.stops, name: words})


def row(told, name):
    found = [line for line in told.lines if line.split()[:1] == [name]]
    assert len(found) == 1, told.lines
    return found[0].split(maxsplit=1)[1]


def releases(told):
    heads = [i for i, line in enumerate(told.lines) if line.startswith("to move")]
    return [line.strip() for line in told.lines[heads[0] + 1 :]] if heads else []


def test_a_healthy_robot_that_stands_tells_how_to_drive_it():
    told = report(healthy())
    assert told.is_healthy
    assert releases(told) == [FREE.format(of="")]
    assert row(told, "pose") == "x +1.00 m  y -0.50 m  heading   +0 deg, 0.0 s old"
    assert row(told, "moves") == "no: it stands"


@pytest.mark.parametrize("source", list(Source))
def test_a_robot_that_drives_has_nothing_to_release(source):
    told = report(healthy(source=source.value, speed=(0.5, 0.1), stands=False))
    assert told.is_healthy
    assert releases(told) == []
    assert "driven by   " + source.value in told.lines
    assert row(told, "moves") == "0.50 m/s, +6 deg/s"


@pytest.mark.parametrize("reason", ["~/stop", "emergency_stop", "wheel_states silent for 0.2 s"])
def test_a_stop_is_told_in_the_nodes_own_words_and_released_by_a_reset(reason):
    robot = with_stop(healthy(source="stop"), CONTROLLER, stop("stopped", reason))
    told = report(with_stop(robot, DRIVE, stop("holding", f"stopped peer {CONTROLLER}")))
    assert not told.is_healthy
    assert row(told, CONTROLLER) == f"STOPPED: {reason}"
    assert row(told, DRIVE) == f"HOLDING: stopped peer {CONTROLLER}"
    assert releases(told) == [RESET]


def test_the_reset_is_that_of_the_robots_namespace():
    robot = healthy(
        prefix="/a",
        movers=frozenset({"/a/platform_controller"}),
        stops={"/a/platform_controller": stop("stopped", "~/stop")},
        diagnostics={"/a/platform_controller": diagnostics(2)},
    )
    assert "omniman reset --namespace /a`" in releases(report(robot))[0]


def test_words_that_speak_of_a_stop_decide_nothing():
    robot = with_words(healthy(), CONTROLLER, diagnostics(text="stopped: emergency_stop"))
    assert report(robot).is_healthy


def test_a_node_that_only_holds_is_released_by_the_reset_of_the_other():
    told = report(with_stop(healthy(), DRIVE, stop("holding", "stopped peer /b")))
    assert releases(told) == [RELEASES[Trouble.HOLDING].format(of="")]


def test_a_node_that_ends_is_started_anew():
    ending = stop("stopped", "shutting down: SIGINT", ending=True)
    told = report(with_stop(healthy(), DRIVE, ending))
    assert row(told, DRIVE) == "ENDING: shutting down: SIGINT"
    assert releases(told) == [RELEASES[Trouble.ENDING]]


@pytest.mark.parametrize("age", [None, SILENCE + 1.0])
def test_a_node_of_the_graph_that_says_nothing_is_silent(age):
    robot = healthy()
    words = {CONTROLLER: robot.diagnostics[CONTROLLER]}
    if age is not None:
        words[DRIVE] = diagnostics(age=age)
    told = report(replace(robot, diagnostics=words))
    assert not told.is_healthy
    assert row(told, DRIVE).startswith("SILENT")
    assert "`omniman reset`" in releases(told)[0]


def test_silence_outweighs_a_stop_that_was_told_before():
    robot = with_stop(healthy(), DRIVE, stop("stopped", "~/stop"))
    told = report(with_words(robot, DRIVE, diagnostics(2, age=SILENCE + 1.0)))
    assert row(told, DRIVE) == "SILENT for 11 s; its last state: stopped: ~/stop"


def test_an_error_without_a_stop_is_a_fault():
    told = report(with_words(healthy(), DRIVE, diagnostics(2, "no process")))
    assert not told.is_healthy
    assert row(told, DRIVE) == "FAULTY: no process"
    assert releases(told) == [RELEASES[Trouble.FAULTY]]


def test_an_error_of_a_node_that_moves_nothing_is_a_fault_too():
    told = report(with_words(healthy(), "/simulated_ur", diagnostics(2, "the simulation failed")))
    assert not told.is_healthy
    assert row(told, "/simulated_ur:") == "the simulation failed"
    assert releases(told) == [RELEASES[Trouble.FAULTY]]


@pytest.mark.parametrize(
    "change", [{"pose_age": 3.0}, {"pose": None, "pose_age": float("inf")}, {"source": None}]
)
def test_a_robot_that_does_not_tell_where_it_is_and_who_drives_is_not_healthy(change):
    told = report(healthy(**change))
    assert not told.is_healthy
    assert releases(told) == [NO_ODOM]


def test_a_robot_whose_way_is_blocked_is_healthy():
    robot = with_words(healthy(), CONTROLLER, diagnostics(motion_limit="0.0"))
    robot = with_words(robot, "/collision_monitor", diagnostics(1, "stop: a person"))
    told = report(robot)
    assert told.is_healthy
    assert row(told, "limit") == "0 %, stop: a person"
    assert releases(told) == [LIMITED]


def test_drives_without_commands_are_told():
    told = report(with_words(healthy(), DRIVE, diagnostics(ramping_to_rest_by_itself="True")))
    assert row(told, DRIVE) == "running; no commands reach it"
    assert releases(told) == [UNCOMMANDED]


def planner(level=0, text="driving", **values):
    robot = healthy(nodes=frozenset({CONTROLLER, DRIVE, PLANNER}), source="mpc")
    return with_words(robot, PLANNER, diagnostics(level, text, **values))


def test_a_goal_is_told_with_its_distance():
    told = report(planner(state="driving", distance_m="1.234", last="started"))
    assert row(told, "goal") == "driving, 1.23 m left (started)"


@pytest.mark.parametrize("distance", ["nan", "inf", "far", ""])
def test_a_distance_of_nonsense_is_as_none(distance):
    told = report(planner(state="driving", distance_m=distance, last="started"))
    assert row(told, "goal") == "driving (started)"


def test_a_warning_is_told_once():
    text = "the goal was given up: ~/stop"
    told = report(planner(1, text, state="idle", distance_m="2.0", last=text))
    assert row(told, "goal") == f"idle ({text})"
    assert "warnings" not in told.lines
    told = report(planner(1, "blocked: a wall", state="blocked", last="started"))
    assert row(told, f"{PLANNER}:") == "blocked: a wall"
    assert told.is_healthy


def test_a_node_that_moves_nothing_may_be_silent():
    told = report(healthy(nodes=frozenset({CONTROLLER, DRIVE, PLANNER})))
    assert row(told, f"{PLANNER}:") == "silent: nothing yet"
    assert told.is_healthy


def test_progress_on_a_path_and_of_the_arm_is_told():
    words = diagnostics(
        state="following", path_progress="0.42", last="started", arm="idle", arm_progress="1.0"
    )
    told = report(with_words(healthy(source="path"), "/path_interpolator", words))
    assert row(told, "path") == "following, 42 % (started)"
    assert row(told, "arm") == "idle"


def test_what_a_terminal_takes_for_a_command_is_left_out():
    told = report(with_stop(healthy(), DRIVE, stop("stopped", "a\x1b[2Jb\nc")))
    assert row(told, DRIVE) == "STOPPED: a [2Jb c"
