import re

import numpy as np

from omniman_ros.viewer.state import SILENCE, Condition, Picture
from omniman_ros.viewer.text import LONGEST, legend, status


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
    shown.hear_odom((1.0, -2.0, np.pi / 2), 10.0)
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
