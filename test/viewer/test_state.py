import numpy as np
import pytest

from omniman_ros.viewer.state import FORGET, SILENCE, Condition, Picture


def test_signals_that_fall_silent_are_no_longer_plotted():
    picture = Picture(3, 0)
    picture.hear_wheels(np.zeros(3), np.ones(3), 10.0)
    picture.hear_commands(np.full(3, 2.0), 10.0)
    picture.sample(10.0)
    picture.sample(10.0 + SILENCE)
    _, *signals = picture.windows["speeds"].columns(10.0 + SILENCE)
    assert [signal[0] for signal in signals] == [1.0] * 3 + [2.0] * 3
    assert np.isnan([signal[1] for signal in signals]).all()
    assert picture.windows["coupling"].columns(11.0)[1:] == ()


def test_commands_of_another_mode_are_no_speeds():
    picture = Picture(3, 0)
    picture.hear_commands(np.ones(3), 10.0)
    picture.hear_commands(None, 10.1)
    picture.sample(10.1)
    _, *signals = picture.windows["speeds"].columns(10.1)
    assert np.isnan(signals).all()


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_any_number_of_coupling_errors_is_heard(count):
    picture = Picture(5, 2)
    picture.hear("coupling", np.arange(1.0, count + 1.0), 10.0)
    picture.sample(10.0)
    _, *signals = picture.windows["coupling"].columns(10.0)
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


def test_a_plan_that_is_not_repeated_is_forgotten():
    picture = Picture(4, 1)
    picture.hear_plan(np.ones((3, 2)), 10.0)
    picture.sample(10.5)
    assert len(picture.plan.points) == 3
    picture.sample(11.5)
    assert len(picture.plan.points) == 0


def test_every_plot_has_a_column_for_each_of_its_curves():
    picture = Picture(3, 2)
    picture.sample(10.0)
    counts = {name: len(window.columns(10.0)) - 1 for name, window in picture.windows.items()}
    assert counts == {
        "speeds": 6, "coupling": 2, "voltages": 3, "energy": 1, "solving": 2, "sending": 2,
    }  # fmt: skip


@pytest.mark.parametrize("name", ["coupling", "voltages", "energy", "solving", "sending"])
def test_a_value_is_plotted_while_it_is_fresh(name):
    picture = Picture(3, 1)
    picture.hear(name, np.ones(3), 10.0)
    picture.sample(10.5)
    picture.sample(10.0 + SILENCE)
    _, first, *_ = picture.windows[name].columns(11.0)
    assert first[0] == 1.0 and np.isnan(first[1])


def test_predicted_obstacles_that_are_not_repeated_are_forgotten():
    picture = Picture(4, 1)
    picture.hear_predicted(np.ones((3, 2)), 10.0)
    picture.sample(10.5)
    assert len(picture.predicted.points) == 3
    picture.sample(11.5)
    assert len(picture.predicted.points) == 0


def test_what_was_heard_is_fresh_for_a_second():
    picture = Picture(4, 1)
    assert not picture.is_fresh("truth", 10.0)
    picture.hear_truth((1.0, 2.0, 0.0), 10.0)
    picture.hear_arm(np.zeros(6), 10.5)
    picture.hear_planner({"state": "idle"}, 10.5)
    fresh = [picture.is_fresh(name, 11.2) for name in ("truth", "arm", "planner", "odom")]
    assert fresh == [False, True, True, False]


def test_when_time_goes_back_nothing_old_is_fresh_and_the_plots_go_on():
    picture = Picture(4, 1)
    picture.hear("coupling", np.array([0.1]), 1000.0)
    picture.hear_complaint("/a", 1, "old", 1000.0)
    picture.sample(1000.0)
    picture.start_over()
    assert not picture.is_fresh("coupling", 5.0)
    assert not picture.complaints
    for i in range(10):
        picture.hear("coupling", np.array([0.2]), 5.0 + 0.05 * i)
        picture.sample(5.0 + 0.05 * i)
    times, values = picture.windows["coupling"].columns(5.45)
    assert len(times) == 10
    assert values.tolist() == [0.2] * 10
