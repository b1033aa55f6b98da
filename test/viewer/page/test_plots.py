"""Data sent to the plots, without a browser."""

import numpy as np
import pytest
import viser

from omniman_ros.viewer.page.page import free_port
from omniman_ros.viewer.page.plots import ARM_PERIOD, DEFAULT_DEADLINE, Plots
from omniman_ros.viewer.view_state import TunableParameter, ViewState

NAMES = ("a", "b", "c", "d")


@pytest.fixture(scope="module")
def server():
    made = viser.ViserServer("127.0.0.1", free_port("127.0.0.1", 18400), verbose=False)
    yield made
    made.stop()


@pytest.fixture
def plots(server):
    yield Plots(server, NAMES, 1, 24.0)
    server.gui.reset()


def handle(plots, name):
    return plots._plots[name]._handle


def visible_plots(plots):
    return {name for name, plot in plots._plots.items() if plot.visible}


def test_a_plot_is_hidden_until_its_signal_arrives(plots):
    state = ViewState(4, 1)
    state.sample(1.0)
    plots.draw(state, 1.0)
    assert visible_plots(plots) == set()
    assert [message.visible for message, _ in plots._waiting] == [True, True]
    state.update_signal("voltages", np.arange(4.0), 1.1)
    state.sample(1.1)
    plots.draw(state, 1.1)
    assert visible_plots(plots) == {"voltages"}
    assert [message.visible for message, _ in plots._waiting] == [False, True]


def test_measured_and_commanded_speeds_are_in_the_order_of_the_lines(plots):
    state = ViewState(4, 1)
    state.update_wheels(None, np.arange(4.0), 1.0)
    state.update_commands(10.0 + np.arange(4.0), 1.0)
    state.sample(1.0)
    plots.draw(state, 1.5)
    data, series = handle(plots, "speeds").data, handle(plots, "speeds").series
    lines = {
        (line["label"], "dash" in line): column[-1]
        for line, column in zip(series[1:9], data[1:9], strict=True)
    }
    assert lines == {(name, False): i for i, name in enumerate(NAMES)} | {
        (name, True): 10.0 + i for i, name in enumerate(NAMES)
    }
    assert data[0][-1] == -0.5
    assert len(data) == len(series)


@pytest.mark.parametrize(
    ("name", "count", "limits"),
    [
        ("voltages", 4, [24.0, -24.0]),
        ("solving", 2, [DEFAULT_DEADLINE]),
        ("sending", 2, [ARM_PERIOD]),
    ],
)
def test_limits_are_drawn_across(plots, name, count, limits):
    state = ViewState(4, 1)
    state.update_signal(name, np.ones(count), 1.0)
    state.sample(1.0)
    plots.draw(state, 1.0)
    data = handle(plots, name).data
    assert [column[-1] for column in data[1 + count : 1 + count + len(limits)]] == limits


def test_the_deadline_is_that_of_the_planner(plots):
    state = ViewState(4, 1)
    state.planner_parameters["safety.deadline"] = TunableParameter(0.025, 0.001, 0.5, "")
    state.update_signal("solving", np.array([20.0, 1.0]), 1.0)
    state.sample(1.0)
    plots.draw(state, 1.0)
    assert handle(plots, "solving").data[3][-1] == 25.0


def test_the_plot_of_a_silent_signal_is_cleared_once(plots, monkeypatch):
    state = ViewState(4, 1)
    state.update_signal("coupling", np.array([0.01]), 1.0)
    state.sample(1.0)
    plots.draw(state, 1.0)
    assert handle(plots, "coupling").data[1][-1] == pytest.approx(10.0), "in mrad"
    sent = []
    state.windows["coupling"] = type(state.windows["coupling"])(1)
    state.sample(40.0)
    plots.draw(state, 40.0)
    wiped = handle(plots, "coupling").data
    assert not np.isfinite(wiped[1]).any()
    monkeypatch.setattr(
        type(handle(plots, "coupling")), "_queue_update", lambda *arguments: sent.append(arguments)
    )
    plots.draw(state, 40.2)
    assert sent == []
    assert plots._plots["coupling"].visible, "nothing moves about because of a silence"


def test_three_wheels_have_no_coupling_error(server):
    plots = Plots(server, NAMES[:3], 0, 24.0)
    assert "coupling" not in plots._plots
    plots.draw(ViewState(3, 0), 1.0)
    server.gui.reset()
