"""`omniman plot` of recordings that the tests write."""

import argparse
import math

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")
pytest.importorskip("matplotlib")

from matplotlib import pyplot as plt

from omniman_ros import extras
from omniman_ros.cli import plot
from omniman_ros.cli.main import main
from omniman_ros.recording import figures as bag_picture
from omniman_ros.recording.reader import BagReader
from omniman_ros.recording.robot_log import read_robot_log
from test.recording import support as s

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
START = 1_000_000.0
END = 4.0


def circle(time):
    """Return pose and body twist on a circle of 1 m radius."""
    return (math.sin(time), 1.0 - math.cos(time), time), (1.0, 0.0, 1.0)


def electrical(volts, joules):
    """Return voltage, current and energy of each wheel, which differ."""
    return [value for k in range(4) for value in (10 * k + volts, 1.0 + k, joules)]


def messages():
    """Return the messages of 4 s on a circle, driven as a path, while the arm turns a joint."""
    rows = [(START, "/active_source", s.text("path"))]
    for k in range(int(END * 50)):
        time = k / 50
        at = START + time
        place, speed = circle(time)
        behind, _ = circle(time - 0.01)
        rows += [
            (at, "/odom", s.odometry(at, behind, speed)),
            (at, "/ground_truth/odom", s.odometry(at, place, speed)),
            (at, "/wheel_states", s.joints(at, WHEELS, (0,) * 4, (time, 2, 3, 4), (0,) * 4)),
            (at, "/wheel_commands", s.joints(at, WHEELS, velocity=(time, 2, 3, 4))),
            (at, "/wheel_electrical", s.numbers(4, 3, data=electrical(k % 7, time))),
            (at, "/coupling_error", s.joints(at, ["constraint_1"], position=(1e-3,))),
            (
                at,
                "/mpc/status",
                s.status(
                    state="driving",
                    solve_ms=9 + k % 3,
                    slack_m=0,
                    distance_m=END - time,
                    energy_j=3,
                ),
            ),
            (at, "/arm/joint_states", s.joints(at, ["j1", "j2"], (0.1 * time, 0.0))),
            (at, "/arm/timing", s.numbers(1, 1, data=(0.008, 0.01))),
        ]
        if k % 2 == 0:
            points = [(n * 0.02, circle(time + n * 0.02)[0]) for n in range(10)]
            rows.append((at, "/path/reference", s.preview(at, points)))
    return rows


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return s.write(tmp_path_factory.mktemp("drive") / "drive", messages())


@pytest.fixture
def log(drive):
    with BagReader(drive) as bag:
        return read_robot_log(bag)


def test_all_figures_are_drawn_and_reported(drive, tmp_path, capsys):
    assert main(["plot", str(drive), "--results", str(tmp_path / "new")]) == 0
    printed = capsys.readouterr().out
    names = [figure.name for figure in bag_picture.FIGURES]
    assert names == ["way", "twist", "wheels", "power", "errors", "planner", "arm"]
    for name in names:
        file = tmp_path / "new" / f"drive_{name}.png"
        assert f"Figure: {file}" in printed
        assert plt.imread(file).std() > 0.02  # not an empty figure
    assert "Not in the recording" not in printed


def test_figures_without_data_are_left_out_and_reported(tmp_path, capsys):
    some = [row for row in messages() if row[1] in ("/odom", "/coupling_error")]
    bag = s.write(tmp_path / "bag", some)
    assert main(["plot", str(bag), "--results", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "Not in the recording: wheels, power, planner, arm" in printed
    assert sorted(file.stem for file in tmp_path.glob("*.png")) == [
        "bag_errors",
        "bag_twist",
        "bag_way",
    ]


def lines(panel):
    """Return times and values of the lines of a panel, by label."""
    return {line.get_label(): line.get_xydata() for line in panel.get_lines()}


def test_the_error_is_measured_to_the_reference_of_the_same_time(log):
    figure = bag_picture.draw_errors(log)
    coupling, position, heading = figure.axes
    # The odometry is 10 ms behind on the circle: 10 mm and 10 mrad.
    during = lines(position)["path/reference"]
    middle = (during[:, 0] > 0.5) & (during[:, 0] < 3.5)
    assert during[middle, 1] == pytest.approx(10.0, abs=0.2)
    assert lines(heading)["path/reference"][middle, 1] == pytest.approx(-10.0, abs=0.2)
    (line,) = coupling.get_lines()
    assert line.get_ydata() == pytest.approx(1e-3)
    plt.close(figure)


def test_voltage_current_and_energy_are_drawn_for_each_wheel(log):
    figure = bag_picture.draw_power(log)
    voltage, current, energy = figure.axes
    assert list(lines(voltage)) == list(lines(current)) == list(WHEELS)
    assert np.nanmax(lines(voltage)["rear_right"][:, 1]) == 36.0
    assert lines(current)["front_right"][:, 1] == pytest.approx(2.0)
    assert lines(energy)["all together"][-1, 1] == pytest.approx(4 * (END - 0.02))
    plt.close(figure)


def test_commanded_and_measured_speed_share_the_panel_of_their_wheel(log):
    figure = bag_picture.draw_wheels(log)
    for axes, name in zip(figure.axes, WHEELS, strict=True):
        assert name in axes.get_title(loc="left") + axes.get_title()
    assert lines(figure.axes[2])["measured"][:, 1] == pytest.approx(3.0)
    assert lines(figure.axes[3])["commanded"][:, 1] == pytest.approx(4.0)
    plt.close(figure)


def test_no_line_is_drawn_where_messages_are_missing(log):
    hole = (log.measured[:, 0] < START + 1.0) | (log.measured[:, 0] > START + 2.0)
    log.measured = log.measured[hole]
    figure = bag_picture.draw_wheels(log)
    drawn = lines(figure.axes[1])["measured"]
    assert np.isnan(drawn).any(axis=1).sum() == 1
    plt.close(figure)


def test_time_starts_with_the_recording(log):
    figure = bag_picture.draw_twist(log)
    left, right = figure.axes[0].get_xlim()
    assert (left, right) == pytest.approx((0.0, END), abs=0.3)
    assert lines(figure.axes[0])["odometry"][0, 0] == pytest.approx(0.0, abs=0.1)
    plt.close(figure)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["/nowhere"], 1, "/nowhere is not a recording"),
        (
            ["--namespace", "robot3", "TWO"],
            2,
            "no robot 'robot3' in the recording; there are robot1, robot2",
        ),
        (["TWO"], 2, "several robots in the recording, choose by --namespace: robot1, robot2"),
        (["NONE"], 1, "no robot in the recording"),
    ],
)
def test_what_cannot_be_drawn_is_reported(tmp_path, capsys, arguments, code, message):
    bags = {
        "TWO": [
            (1.0, f"/{name}/odom", s.odometry(1.0, (0, 0, 0))) for name in ("robot1", "robot2")
        ],
        "NONE": [(1.0, "/rosout", s.text("hello"))],
    }
    given = [
        str(s.write(tmp_path / word, bags[word])) if word in bags else word for word in arguments
    ]
    assert main(["plot", *given, "--results", str(tmp_path / "pictures")]) == code
    assert message in capsys.readouterr().err
    assert not (tmp_path / "pictures").exists()


def test_figures_are_opened_with_show(drive, tmp_path, monkeypatch):
    file, opened = tmp_path / "way.png", []
    monkeypatch.setattr(bag_picture, "draw_figures", lambda *_: {"way": file})
    monkeypatch.setattr(plot.webbrowser, "open", opened.append)
    args = argparse.Namespace(bag=str(drive), results=str(tmp_path), namespace="", show=False)
    assert plot.run(args) == 0
    assert opened == []
    args.show = True
    assert plot.run(args) == 0
    assert opened == [file.as_uri()]


def test_without_the_library_the_error_says_how_to_install_it(drive, monkeypatch, capsys):
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    assert main(["plot", str(drive)]) == 1
    assert "pip install rosbags" in capsys.readouterr().err
