"""What is sent to the plots, without a browser."""

import numpy as np
import pytest

from omniman_ros.viewer.state import Picture, Tunable

viser = pytest.importorskip("viser", reason="viser is not installed (extra 'viewer')")

from omniman_ros.viewer.page import free_port  # noqa: E402
from omniman_ros.viewer.plots import ARM_PERIOD, DEADLINE, Plots  # noqa: E402

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


def seen(plots):
    return {name for name, plot in plots._plots.items() if plot.visible}


def test_a_plot_is_not_seen_until_something_is_heard(plots):
    picture = Picture(4, 1)
    picture.sample(1.0)
    plots.draw(picture, 1.0)
    assert seen(plots) == set()
    assert [said.visible for said, _ in plots._waiting] == [True, True]
    picture.hear("voltages", np.arange(4.0), 1.1)
    picture.sample(1.1)
    plots.draw(picture, 1.1)
    assert seen(plots) == {"voltages"}
    assert [said.visible for said, _ in plots._waiting] == [False, True]


def test_measured_and_commanded_speeds_are_in_the_order_of_the_lines(plots):
    picture = Picture(4, 1)
    picture.hear_wheels(None, np.arange(4.0), 1.0)
    picture.hear_commands(10.0 + np.arange(4.0), 1.0)
    picture.sample(1.0)
    plots.draw(picture, 1.5)
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
    [("voltages", 4, [24.0, -24.0]), ("solving", 2, [DEADLINE]), ("sending", 2, [ARM_PERIOD])],
)
def test_limits_are_drawn_across(plots, name, count, limits):
    picture = Picture(4, 1)
    picture.hear(name, np.ones(count), 1.0)
    picture.sample(1.0)
    plots.draw(picture, 1.0)
    data = handle(plots, name).data
    assert [column[-1] for column in data[1 + count : 1 + count + len(limits)]] == limits


def test_the_deadline_is_that_of_the_planner(plots):
    picture = Picture(4, 1)
    picture.tunables["safety.deadline"] = Tunable(0.025, 0.001, 0.5, "")
    picture.hear("solving", np.array([20.0, 1.0]), 1.0)
    picture.sample(1.0)
    plots.draw(picture, 1.0)
    assert handle(plots, "solving").data[3][-1] == 25.0


def test_a_plot_of_what_has_fallen_silent_is_wiped_once(plots, monkeypatch):
    picture = Picture(4, 1)
    picture.hear("coupling", np.array([0.01]), 1.0)
    picture.sample(1.0)
    plots.draw(picture, 1.0)
    assert handle(plots, "coupling").data[1][-1] == pytest.approx(10.0), "in mrad"
    sent = []
    picture.windows["coupling"] = type(picture.windows["coupling"])(1)
    picture.sample(40.0)
    plots.draw(picture, 40.0)
    wiped = handle(plots, "coupling").data
    assert not np.isfinite(wiped[1]).any()
    monkeypatch.setattr(type(handle(plots, "coupling")), "_queue_update",
                        lambda *told: sent.append(told))  # fmt: skip
    plots.draw(picture, 40.2)
    assert sent == []
    assert plots._plots["coupling"].visible, "nothing moves about because of a silence"


def test_three_wheels_have_no_coupling_error(server):
    plots = Plots(server, NAMES[:3], 0, 24.0)
    assert "coupling" not in plots._plots
    plots.draw(Picture(3, 0), 1.0)
    server.gui.reset()
