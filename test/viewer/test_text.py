import re

import numpy as np

from omniman_ros.viewer.state import SILENCE, Condition, Picture
from omniman_ros.viewer.text import BAD, FIRST_STEPS, GOOD, LONGEST, hint, legend, status


def words(html):
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", html)).strip()


def picture(**attributes):
    made = Picture(4, 1)
    for name, value in attributes.items():
        setattr(made, name, value)
    return made


def test_a_page_without_a_robot_says_what_it_waits_for():
    text = words(status(picture(), 10.0))
    assert "waiting for platform_controller" in text
    assert "odom not heard yet" in text


def test_it_says_who_drives_what_holds_and_where_the_robot_is():
    shown = picture(
        active_source="path", stops={"/r/simulated_drive": Condition(0, "running")},
    )  # fmt: skip
    shown.hear_progress(0.424, 10.0)
    shown.hear_odom((1.0, -2.0, 4.5 * np.pi), 10.0)
    shown.hear_truth((1.003, -2.004, np.pi / 2), 10.0)
    text = words(status(shown, 10.0))
    for part in ("driven by path", "simulated_drive running", "odom +1.00 -2.00 m +90°",
                 "off the truth 5.0 mm", "path 42 %"):  # fmt: skip
        assert part in text


def test_the_progress_is_left_out_where_there_is_no_path():
    shown = picture()
    assert "path" not in words(status(shown, 10.0)).split()
    shown.hear_progress(0.5, 10.0)
    assert "path 50 %" in words(status(shown, 10.0))
    assert "path" not in words(status(shown, 10.0 + SILENCE)).split()


def test_the_truth_is_left_out_where_there_is_none():
    shown = picture()
    shown.hear_odom((0.0, 0.0, 0.0), 10.0)
    assert "truth" not in status(shown, 10.0)
    shown.hear_truth((0.0, 0.0, 0.0), 10.0)
    assert "truth" not in status(shown, 10.0 + SILENCE)


def test_a_stop_and_its_complaint_are_said_once():
    shown = picture(
        stops={"/a": Condition(2, "stopped: a wheel does not follow")},
        complaints={"/a": Condition(2, "a wheel does not follow"), "/b": Condition(1, "slips")},
    )
    text = words(status(shown, 10.0))
    assert text.count("does not follow") == 1
    assert "b slips" in text


def test_what_nodes_say_cannot_become_part_of_the_page():
    evil = "<img src=x onerror=alert(1)>"
    shown = picture(
        active_source=evil, note=evil,
        stops={f"/{evil}": Condition(2, evil)},
        complaints={f"/x{evil}": Condition(1, evil + "!")},
    )  # fmt: skip
    html = status(shown, 10.0) + legend((evil,), ("#000",))
    assert "<img" not in html
    assert html.count("&lt;img") >= 6


def test_a_long_message_is_cut():
    assert len(words(status(picture(note="x" * 10_000), 10.0))) < LONGEST + 200


def planning(**said):
    shown = picture(active_source="mpc")
    shown.hear_planner(said, 10.0)
    return shown


def test_it_says_what_the_planner_does_and_why_it_is_blocked():
    html = status(planning(state="driving", distance_m="2.31", why=""), 10.0)
    assert "planner driving, 2.31 m to go" in words(html)
    assert f'color:{GOOD}">driving' in html
    html = status(planning(state="blocked", distance_m="2.31", why="no clear way found"), 10.0)
    assert "planner blocked, 2.31 m to go: no clear way found" in words(html)
    assert f'color:{BAD}">blocked' in html
    assert "to go" not in status(planning(state="idle", distance_m="0.0"), 10.0)


def test_the_planner_is_left_out_while_it_is_silent():
    assert "planner" not in status(picture(), 10.0)
    assert "planner" not in status(planning(state="idle"), 10.0 + SILENCE)


def test_who_has_done_nothing_yet_is_told_what_to_do():
    assert FIRST_STEPS in status(picture(active_source="none"), 10.0)
    for done in ({"note": "stop: done"}, {"active_source": "path"}, {"active_source": ""}):
        assert FIRST_STEPS not in status(picture(**{"active_source": "none", **done}), 10.0)
    for line in ("path", "plan"):
        shown = picture(active_source="none")
        getattr(shown, line).set(np.zeros((2, 2)))
        assert FIRST_STEPS not in status(shown, 10.0)


def test_a_hint_is_escaped():
    assert "&lt;b&gt;" in hint("<b>")
