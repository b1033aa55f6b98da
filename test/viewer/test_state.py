import math

import numpy as np
import pytest

from omniman_ros.viewer.state import (
    CORNERS,
    FORGET,
    SILENCE,
    SPACING,
    Condition,
    Line,
    Picture,
    Trail,
    Window,
    outlines,
    segments,
    thinned,
)


def test_a_trail_takes_points_that_are_far_enough_apart():
    trail = Trail(spacing=0.1)
    for x in np.arange(0.0, 1.0, 0.03):
        trail.add(x, 0.0)
    steps = np.diff(trail.points[:, 0])
    assert len(steps) > 5
    assert (steps >= 0.1).all() and (steps < 0.13).all()


def test_a_trail_is_bounded_and_keeps_the_newest():
    trail = Trail(limit=50)
    for i in range(1, 1001):
        trail.add(float(i), -float(i))
        assert trail.points[:, 0].tolist() == list(range(max(i - 49, 1), i + 1))
    assert trail.points[-1].tolist() == [1000.0, -1000.0]


def test_the_version_of_a_trail_changes_with_its_points():
    trail = Trail()
    trail.add(0.0, 0.0)
    version = trail.version
    trail.add(0.5 * SPACING, 0.0)
    assert trail.version == version
    trail.add(2.0 * SPACING, 0.0)
    assert trail.version != version
    version = trail.version
    trail.clear()
    assert len(trail.points) == 0 and trail.version != version


def test_a_line_is_broken_where_it_jumps():
    points = np.array([[0.0, 0.0], [0.1, 0.0], [5.0, 5.0], [5.0, 5.1]])
    assert len(segments(points)) == 3
    pieces = segments(points, jump=0.5)
    assert pieces.tolist() == [[[0.0, 0.0], [0.1, 0.0]], [[5.0, 5.0], [5.0, 5.1]]]


@pytest.mark.parametrize("count", [0, 1])
def test_a_line_of_too_few_points_has_no_pieces(count):
    assert segments(np.zeros((count, 2)), 0.5).shape == (0, 2, 2)


@pytest.mark.parametrize("count", [0, 1, 7, 10, 11, 1000, 10**6])
def test_a_long_path_is_thinned_evenly_to_its_ends(count):
    chosen = list(thinned(count, 10))
    assert len(chosen) == min(count, 10)
    if count:
        assert (chosen[0], chosen[-1]) == (0, count - 1)
    gaps = np.diff(chosen)
    assert gaps.size == 0 or gaps.max() - gaps.min() <= 1


def test_a_window_holds_the_last_seconds():
    window = Window(2, span=2.0, rate=10.0)
    for i in range(50):
        window.sample(100.0 + 0.1 * i, np.array([i, -i], dtype=float))
    times, first, second = window.columns(104.9)
    assert times[0] >= -2.0 and times[-1] == 0.0
    assert len(times) == 20
    assert np.allclose(np.diff(times), 0.1)
    assert first.tolist() == list(range(30, 50))
    assert (second == -first).all()


def test_a_window_shows_nothing_that_is_older_than_it_spans():
    window = Window(1, span=2.0, rate=10.0)
    window.sample(100.0, np.array([1.0]))
    window.sample(103.0, np.array([2.0]))
    times, values = window.columns(103.0)
    assert times.tolist() == [0.0] and values.tolist() == [2.0]
    assert [len(column) for column in window.columns(200.0)] == [0, 0]


def test_a_sample_that_comes_too_soon_replaces_the_last():
    window = Window(1, span=2.0, rate=10.0)
    for i in range(100):
        window.sample(100.0 + 0.001 * i, np.array([float(i)]))
    times, values = window.columns(100.1)
    assert len(times) == 2
    assert values[-1] == 99.0


def test_signals_that_fall_silent_are_no_longer_plotted():
    picture = Picture(3, 0)
    picture.hear_wheels(np.zeros(3), np.ones(3), 10.0)
    picture.hear_commands(np.full(3, 2.0), 10.0)
    picture.sample(10.0)
    picture.sample(10.0 + SILENCE)
    _, *signals = picture.wheel_speeds.columns(10.0 + SILENCE)
    assert [signal[0] for signal in signals] == [1.0] * 3 + [2.0] * 3
    assert np.isnan([signal[1] for signal in signals]).all()
    assert picture.coupling.columns(11.0)[1:] == ()


def test_commands_of_another_mode_are_no_speeds():
    picture = Picture(3, 0)
    picture.hear_commands(np.ones(3), 10.0)
    picture.hear_commands(None, 10.1)
    picture.sample(10.1)
    _, *signals = picture.wheel_speeds.columns(10.1)
    assert np.isnan(signals).all()


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_any_number_of_coupling_errors_is_heard(count):
    picture = Picture(5, 2)
    picture.hear_coupling(np.arange(1.0, count + 1.0), 10.0)
    picture.sample(10.0)
    _, *signals = picture.coupling.columns(10.0)
    assert [s[0] for s in signals][: min(count, 2)] == [1.0, 2.0][: min(count, 2)]
    assert np.isnan([s[0] for s in signals][count:]).all()


def test_a_reference_that_is_not_continued_is_taken_away():
    picture = Picture(4, 1)
    picture.hear_reference(np.ones((3, 2)), 10.0)
    picture.sample(10.0)
    assert len(picture.reference.points) == 3
    version = picture.reference.version
    for i in range(3):
        picture.sample(10.0 + SILENCE + 0.05 * i)
    assert len(picture.reference.points) == 0
    assert picture.reference.version == version + 1, "once"


def test_a_complaint_is_cleared_by_good_news_and_forgotten_in_silence():
    picture = Picture(4, 1)
    picture.hear_complaint("/a", 1, "the wheels slip", 10.0)
    picture.hear_complaint("/b", 2, "dead", 10.0)
    picture.hear_complaint("/a", 0, "running", 10.5)
    picture.sample(10.5)
    assert picture.complaints == {"/b": Condition(2, "dead", 10.0)}
    picture.sample(10.0 + FORGET)
    assert picture.complaints == {}


def test_a_node_that_is_gone_is_marked_until_it_is_back():
    picture = Picture(4, 1)
    picture.stops = {"/a": Condition(0, "running"), "/b": Condition(2, "stopped: x")}
    picture.keep_stops(["/a", "/c"])
    assert picture.stops == {"/a": Condition(0, "running"), "/b": Condition(2, "gone")}


def test_a_line_that_is_set_is_new():
    line = Line()
    line.set(np.zeros((2, 2)))
    assert line.version == 1 and line.points.shape == (2, 2)


def test_outlines_go_around_each_obstacle_with_a_gap_between_two():
    centers, axes = np.array([[1.0, 2.0], [4.0, 0.0]]), np.array([[0.5, 0.2], [1.0, 1.0]])
    points = outlines(centers, axes, np.array([math.pi / 2, 0.0]))
    pieces = segments(points)
    assert len(pieces) == 2 * CORNERS
    first, second = pieces[:CORNERS].reshape(-1, 2), pieces[CORNERS:].reshape(-1, 2)
    around = (first - centers[0]) / [0.2, 0.5]  # it is turned by 90 degrees
    assert np.hypot(*around.T) == pytest.approx(1.0)
    assert np.hypot(*(second - centers[1]).T) == pytest.approx(1.0)


def test_a_plan_that_is_not_repeated_is_forgotten():
    picture = Picture(4, 1)
    picture.hear_plan(np.ones((3, 2)), 10.0)
    picture.sample(10.5)
    assert len(picture.plan.points) == 3
    picture.sample(11.5)
    assert len(picture.plan.points) == 0
