import numpy as np
import pytest

from omniman_ros.viewer.view_state import (
    DIAGNOSTICS_TIMEOUT,
    FRESHNESS_TIMEOUT,
    Condition,
    ViewState,
)


def test_signals_that_fall_silent_are_no_longer_plotted():
    state = ViewState(3, 0)
    state.update_wheels(np.zeros(3), np.ones(3), 10.0)
    state.update_commands(np.full(3, 2.0), 10.0)
    state.sample(10.0)
    state.sample(10.0 + FRESHNESS_TIMEOUT)
    _, *signals = state.windows["speeds"].columns(10.0 + FRESHNESS_TIMEOUT)
    assert [signal[0] for signal in signals] == [1.0] * 3 + [2.0] * 3
    assert np.isnan([signal[1] for signal in signals]).all()
    assert state.windows["coupling"].columns(11.0)[1:] == ()


def test_commands_of_another_mode_are_not_plotted_as_speeds():
    state = ViewState(3, 0)
    state.update_commands(np.ones(3), 10.0)
    state.update_commands(None, 10.1)
    state.sample(10.1)
    _, *signals = state.windows["speeds"].columns(10.1)
    assert np.isnan(signals).all()


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_any_number_of_coupling_errors_is_accepted(count):
    state = ViewState(5, 2)
    state.update_signal("coupling", np.arange(1.0, count + 1.0), 10.0)
    state.sample(10.0)
    _, *signals = state.windows["coupling"].columns(10.0)
    assert [s[0] for s in signals][: min(count, 2)] == [1.0, 2.0][: min(count, 2)]
    assert np.isnan([s[0] for s in signals][count:]).all()


def test_a_reference_that_is_not_repeated_is_discarded():
    state = ViewState(4, 1)
    state.update_line("reference", np.ones((3, 2)), 10.0)
    state.sample(10.0)
    assert len(state.reference.points) == 3
    version = state.reference.version
    for i in range(3):
        state.sample(10.0 + FRESHNESS_TIMEOUT + 0.05 * i)
    assert len(state.reference.points) == 0
    assert state.reference.version == version + 1, "once"


def test_diagnostics_are_cleared_by_ok_and_by_silence():
    state = ViewState(4, 1)
    state.update_diagnostics("/a", 1, "the wheels slip", 10.0)
    state.update_diagnostics("/b", 2, "dead", 10.0)
    state.update_diagnostics("/a", 0, "running", 10.5)
    state.sample(10.5)
    assert state.diagnostics == {"/b": Condition(2, "dead", 10.0)}
    state.sample(10.0 + DIAGNOSTICS_TIMEOUT)
    assert state.diagnostics == {}


def test_a_missing_node_is_marked_until_it_returns():
    state = ViewState(4, 1)
    state.stops = {"/a": Condition(0, "running"), "/b": Condition(2, "stopped: x")}
    state.mark_gone(["/a", "/c"])
    assert state.stops == {"/a": Condition(0, "running"), "/b": Condition(2, "gone")}


def test_a_plan_that_is_not_repeated_is_discarded():
    state = ViewState(4, 1)
    state.update_line("plan", np.ones((3, 2)), 10.0)
    state.sample(10.5)
    assert len(state.plan.points) == 3
    state.sample(11.5)
    assert len(state.plan.points) == 0


@pytest.mark.parametrize("name", ["coupling", "voltages", "energy", "solving", "sending"])
def test_a_value_is_plotted_while_it_is_fresh(name):
    state = ViewState(3, 1)
    state.update_signal(name, np.ones(3), 10.0)
    state.sample(10.5)
    state.sample(10.0 + FRESHNESS_TIMEOUT)
    _, first, *_ = state.windows[name].columns(11.0)
    assert first[0] == 1.0 and np.isnan(first[1])


def test_a_received_value_is_fresh_for_a_second():
    state = ViewState(4, 1)
    assert not state.is_fresh("truth", 10.0)
    state.update_truth((1.0, 2.0, 0.0), 10.0)
    state.update_arm(np.zeros(6), 10.5)
    state.update_planner({"state": "idle"}, 10.5)
    fresh = [state.is_fresh(name, 11.2) for name in ("truth", "arm", "planner", "odom")]
    assert fresh == [False, True, True, False]


def test_after_a_jump_back_in_time_old_values_are_stale_and_plots_continue():
    state = ViewState(4, 1)
    state.update_signal("coupling", np.array([0.1]), 1000.0)
    state.update_diagnostics("/a", 1, "old", 1000.0)
    state.sample(1000.0)
    state.reset_time()
    assert not state.is_fresh("coupling", 5.0)
    assert not state.diagnostics
    for i in range(10):
        state.update_signal("coupling", np.array([0.2]), 5.0 + 0.05 * i)
        state.sample(5.0 + 0.05 * i)
    times, values = state.windows["coupling"].columns(5.45)
    assert len(times) == 10
    assert values.tolist() == [0.2] * 10


@pytest.mark.parametrize(
    ("reported", "applicable"),
    [
        ("idle", set()),
        ("arrived", set()),
        ("driving", {"pause", "cancel"}),
        ("blocked", {"pause", "cancel"}),
        ("paused", {"resume", "cancel"}),
    ],
)
def test_actions_that_do_not_apply_to_the_planner_are_known(reported, applicable):
    state = ViewState(4, 1)
    actions = {"pause", "resume", "cancel"}
    assert not any(state.reports_nothing_to(a, "mpc_planner") for a in actions), "not yet known"
    state.update_planner({"state": reported}, 10.0)
    left = {a for a in actions if not state.reports_nothing_to(a, "mpc_planner")}
    assert left == applicable


@pytest.mark.parametrize(
    ("reported", "applicable"),
    [
        ({"idle"}, set()),
        ({"idle", "following"}, {"pause", "cancel"}),
        ({"idle", "slowing"}, {"pause", "cancel"}),
        ({"paused", "idle"}, {"resume", "cancel"}),
        ({"pausing"}, {"resume", "cancel"}),
        ({"cancelling"}, {"cancel"}),
    ],
)
def test_actions_that_do_not_apply_to_the_path_interpolator_are_known(reported, applicable):
    state = ViewState(4, 1)
    actions = {"pause", "resume", "cancel"}
    assert not any(state.reports_nothing_to(a, "path_interpolator") for a in actions)
    state.path_states["path_interpolator"] = frozenset(reported)
    assert {
        a for a in actions if not state.reports_nothing_to(a, "path_interpolator")
    } == applicable


@pytest.mark.parametrize("node", ["mpc_planner", "path_interpolator"])
def test_a_new_run_forgets_how_the_last_one_ended_until_another_ends(node):
    state, ended = ViewState(4, 1), "given up: emergency_stop"
    state.update_diagnostics(node, 1, ended, 1.0, {ended, ""})
    state.update_diagnostics("other", 1, "something else", 1.0)
    state.begin_run()
    state.update_diagnostics(node, 1, ended, 2.0, {ended, ""})
    assert list(state.diagnostics) == ["other"]
    state.update_diagnostics(node, 0, "driving", 3.0, {""})
    state.update_diagnostics(node, 1, ended, 4.0, {ended, ""})
    assert node in state.diagnostics


def test_an_outcome_that_a_stop_hides_is_forgotten_too():
    state, ended = ViewState(4, 1), "given up: emergency_stop"
    state.update_diagnostics("planner", 2, "stopped: emergency_stop", 1.0, {ended})
    state.begin_run()
    assert "planner" in state.diagnostics
    state.update_diagnostics("planner", 1, ended, 2.0, {ended})
    assert not state.diagnostics
