import re

import numpy as np

from omniman_ros.viewer.perceived import FRESHNESS_TIMEOUT
from omniman_ros.viewer.status_text import BAD, GOOD, MAX_LENGTH, hint, legend, status
from omniman_ros.viewer.view_state import Condition, ViewState


def words(html):
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", html)).strip()


def state(**attributes):
    made = ViewState(4, 1)
    for name, value in attributes.items():
        setattr(made, name, value)
    return made


def test_a_page_without_a_robot_displays_the_awaited_topics():
    text = words(status(state(), 10.0))
    assert "waiting for platform_controller" in text
    assert "odom not received yet" in text


def test_the_status_contains_source_stops_and_pose():
    shown = state(
        active_source="path",
        stops={"/r/simulated_drive": Condition(0, "running")},
    )
    shown.update_progress(0.424, 10.0)
    shown.update_odom((1.0, -2.0, 4.5 * np.pi), 10.0)
    shown.update_truth((1.003, -2.004, np.pi / 2), 10.0)
    text = words(status(shown, 10.0))
    for part in (
        "driven by path",
        "simulated_drive running",
        "odom +1.00 -2.00 m +90°",
        "odometry error 5.0 mm",
        "path 42 %",
    ):
        assert part in text


def test_the_pace_of_simulated_time_is_displayed_and_who_is_awaited():
    assert "simulated time" not in words(status(state(), 10.0))
    text = words(status(state(pace=0.618), 10.0))
    assert "simulated time 0.62 times real time" in text
    text = words(status(state(pace=0.6, awaited=("/r/mpc_planner", "/r/arm_streamer")), 10.0))
    assert "simulated time is waiting for mpc_planner, arm_streamer" in text
    assert "0.6" not in text


def test_what_cannot_be_placed_is_displayed_with_the_reason():
    text = words(status(state(unplaced={"goal_pose": "no transform of frame '<b>'"}), 10.0))
    assert "goal_pose not shown: no transform of frame '&lt;b&gt;'".replace("'", "&#x27;") in text


def test_progress_is_omitted_without_a_path():
    shown = state()
    assert "path" not in words(status(shown, 10.0)).split()
    shown.update_progress(0.5, 10.0)
    assert "path 50 %" in words(status(shown, 10.0))
    assert "path" not in words(status(shown, 10.0 + FRESHNESS_TIMEOUT)).split()


def test_ground_truth_is_omitted_if_there_is_none():
    shown = state()
    shown.update_odom((0.0, 0.0, 0.0), 10.0)
    assert "odometry error" not in status(shown, 10.0)
    shown.update_truth((0.0, 0.0, 0.0), 10.0)
    assert "odometry error" not in status(shown, 10.0 + FRESHNESS_TIMEOUT)


def test_a_stop_and_its_diagnostics_are_displayed_once():
    shown = state(
        stops={"/a": Condition(2, "stopped: a wheel does not follow")},
        diagnostics={"/a": Condition(2, "a wheel does not follow"), "/b": Condition(1, "slips")},
    )
    text = words(status(shown, 10.0))
    assert text.count("does not follow") == 1
    assert "b slips" in text


def test_text_of_nodes_is_escaped():
    evil = "<img src=x onerror=alert(1)>"
    shown = state(
        active_source=evil,
        note=evil,
        stops={f"/{evil}": Condition(2, evil)},
        diagnostics={f"/x{evil}": Condition(1, evil + "!")},
    )
    html = status(shown, 10.0) + legend((evil,), ("#000",))
    assert "<img" not in html
    assert html.count("&lt;img") >= 6


def test_a_long_message_is_cut():
    assert len(words(status(state(note="x" * 10_000), 10.0))) < MAX_LENGTH + 200


def planning(**values):
    shown = state(active_source="mpc")
    shown.update_planner(values, 10.0)
    return shown


def test_the_status_contains_the_planners_state_and_reason():
    html = status(planning(state="driving", distance_m="2.31", why=""), 10.0)
    assert "planner driving, 2.31 m to go" in words(html)
    assert f'color:{GOOD}">driving' in html
    html = status(planning(state="blocked", distance_m="2.31", why="no clear way found"), 10.0)
    assert "planner blocked, 2.31 m to go: no clear way found" in words(html)
    assert f'color:{BAD}">blocked' in html
    assert "to go" not in status(planning(state="idle", distance_m="0.0"), 10.0)


def test_a_silent_planner_is_omitted():
    assert "planner" not in status(state(), 10.0)
    assert "planner" not in status(planning(state="idle"), 10.0 + FRESHNESS_TIMEOUT)


def test_the_step_of_the_tour_comes_first():
    html = status(state(active_source="none", tour="1 of 6: hold", note="reset: done"), 10.0)
    assert html.index("1 of 6: hold") < html.index("driven by") < html.index("reset: done")
    assert "of 6" not in status(state(active_source="none"), 10.0)


def test_a_hint_is_escaped():
    assert "&lt;b&gt;" in hint("<b>")
