import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.recording.film.shots import LEAST_ON_SCREEN, Shot, cut
from test.recording.film.logs import log_of, series


def kinds(shots):
    return [(shot.kind, shot.start, shot.end) for shot in shots]


def test_only_what_drives_is_shown_and_parts_of_a_kind_are_joined_over_short_rests():
    log = log_of(
        [(0.0, "none"), (1.0, "cmd_vel"), (3.0, "none"), (3.5, "cmd_vel"), (6.0, "none"),
         (9.0, "cmd_vel"), (12.0, "none"), (15.0, "mpc"), (15.4, "none")],
        20.0,
    )  # fmt: skip
    assert kinds(cut(log, 100.0)) == [("cmd_vel", 1.0, 6.0), ("cmd_vel", 9.0, 12.0)]


def test_a_path_is_one_of_the_tool_if_that_was_sent_last():
    sources = [(2.0, "path"), (5.0, "none"), (8.0, "path"), (11.0, "none"), (14.0, "path")]
    log = log_of(
        sources,
        18.0,
        paths=series((1.0, np.zeros((2, 2)))),
        tool_paths=series((7.0, np.zeros((2, 3)))),
        trajectories=series((13.0, None)),
    )
    assert [shot.kind for shot in cut(log, 100.0)] == ["path", "tool", "path"]


def test_a_drive_in_which_a_wheel_loses_its_torque_is_a_fault():
    wheels = series((0.0, ()), (3.0, ("rear_left",)), (6.0, ()))
    log = log_of([(2.0, "path"), (5.0, "none"), (7.0, "path")], 10.0, dead_wheels=wheels)
    assert [shot.kind for shot in cut(log, 100.0)] == ["fault", "path"]


def test_a_stop_is_shown_with_the_end_of_the_drive_before_it():
    log = log_of([(1.0, "cmd_vel"), (7.0, "stop"), (20.0, "none"), (25.0, "stop")], 30.0)
    assert kinds(cut(log, 100.0)) == [("cmd_vel", 1.0, 5.0), ("stop", 5.0, 8.8)]


def test_a_drive_that_the_film_has_time_for_is_shown_at_its_own_speed():
    log = log_of([(1.0, "cmd_vel"), (7.0, "none")], 10.0)
    assert [shot.speed for shot in cut(log, 10.0)] == [pytest.approx(1.0)]


def test_a_longer_drive_fills_the_film_and_short_shots_are_slower():
    sources = [(0.0, "cmd_vel"), (50.0, "none"), (60.0, "mpc"), (64.0, "none")]
    long, short = cut(log_of(sources, 70.0), 10.0)
    assert long.on_screen + short.on_screen == pytest.approx(10.0, abs=1e-3)
    assert short.on_screen == pytest.approx(LEAST_ON_SCREEN)
    assert long.speed == pytest.approx(50.0 / 8.0, rel=1e-3)


def test_the_frames_of_a_shot_are_evenly_spread_over_it():
    times = Shot("path", 10.0, 16.0, 3.0).times(12.0)
    assert len(times) == 24
    assert np.diff(times) == pytest.approx(np.full(23, 0.25))
    assert (times[0], times[-1]) == (pytest.approx(10.125), pytest.approx(15.875))


@pytest.mark.parametrize("sources", [[], [(0.0, "none")], [(0.0, "stop")]])
def test_a_recording_in_which_nothing_drove_is_refused(sources):
    with pytest.raises(InputError, match="no source drove the platform"):
        cut(log_of(sources, 10.0), 25.0)
