"""`omniman plot` of recordings that are made here."""

import argparse
import math

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")
pytest.importorskip("matplotlib")

from matplotlib import pyplot as plt

from omniman_ros.bag.reader import BagReader
from omniman_ros.bag.robot_log import read
from omniman_ros.cli import bag_picture, plot
from omniman_ros.cli.main import main

from ..bag import support as s

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
START = 1_000_000.0
END = 4.0


def circle(time):
    """Pose and body twist on a circle of 1 m."""
    return (math.sin(time), 1.0 - math.cos(time), time), (1.0, 0.0, 1.0)


def electric(volts, joules):
    """Voltage, current and energy of the wheels, which differ."""
    return [value for k in range(4) for value in (10 * k + volts, 1.0 + k, joules)]


def messages():
    """A drive of 4 s on a circle, by its path, and an arm that turns a joint."""
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
            (at, "/wheel_electrical", s.numbers(4, 3, data=electric(k % 7, time))),
            (at, "/coupling_error", s.joints(at, ["constraint_1"], position=(1e-3,))),
            (at, "/mpc/status", s.status(state="driving", solve_ms=9 + k % 3, slack_m=0,
                                         distance_m=END - time, energy_j=3)),
            (at, "/arm/joint_states", s.joints(at, ["j1", "j2"], (0.1 * time, 0.0))),
            (at, "/arm/timing", s.numbers(1, 1, data=(0.008, 0.01))),
        ]  # fmt: skip
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
        return read(bag)


def test_all_figures_are_drawn_and_told(drive, tmp_path, capsys):
    assert main(["plot", str(drive), "--results", str(tmp_path / "new")]) == 0
    told = capsys.readouterr().out
    names = [name for name, _, _ in bag_picture.FIGURES]
    assert names == ["way", "twist", "wheels", "power", "errors", "planner", "arm"]
    for name in names:
        file = tmp_path / "new" / f"drive_{name}.png"
        assert f"Picture: {file}" in told
        assert plt.imread(file).std() > 0.02  # not an empty sheet
    assert "Not in the recording" not in told


def test_what_is_not_in_the_recording_is_left_out_with_a_word(tmp_path, capsys):
    some = [row for row in messages() if row[1] in ("/odom", "/coupling_error")]
    bag = s.write(tmp_path / "bag", some)
    assert main(["plot", str(bag), "--results", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "Not in the recording: wheels, power, planner, arm" in told
    assert sorted(file.stem for file in tmp_path.glob("*.png")) == [
        "bag_errors", "bag_twist", "bag_way"
    ]  # fmt: skip


def lines(panel):
    """Label -> times and values of the lines of a panel."""
    return {line.get_label(): line.get_xydata() for line in panel.get_lines()}


def test_the_error_is_that_to_the_reference_of_the_same_time(log):
    sheet = bag_picture._errors(log)
    coupling, position, heading = sheet.axes
    # The odometry is 10 ms behind on the circle: 10 mm and 10 mrad.
    during = lines(position)["path/reference"]
    middle = (during[:, 0] > 0.5) & (during[:, 0] < 3.5)
    assert during[middle, 1] == pytest.approx(10.0, abs=0.2)
    assert lines(heading)["path/reference"][middle, 1] == pytest.approx(-10.0, abs=0.2)
    (line,) = coupling.get_lines()
    assert line.get_ydata() == pytest.approx(1e-3)
    plt.close(sheet)


def test_voltages_currents_and_energies_are_those_of_each_wheel(log):
    sheet = bag_picture._power(log)
    voltage, current, energy = sheet.axes
    assert list(lines(voltage)) == list(lines(current)) == list(WHEELS)
    assert np.nanmax(lines(voltage)["rear_right"][:, 1]) == 36.0
    assert lines(current)["front_right"][:, 1] == pytest.approx(2.0)
    assert lines(energy)["all together"][-1, 1] == pytest.approx(4 * (END - 0.02))
    plt.close(sheet)


def test_commanded_and_measured_speed_are_in_the_panel_of_their_wheel(log):
    sheet = bag_picture._wheels(log)
    for axes, name in zip(sheet.axes, WHEELS, strict=True):
        assert name in axes.get_title(loc="left") + axes.get_title()
    assert lines(sheet.axes[2])["measured"][:, 1] == pytest.approx(3.0)
    assert lines(sheet.axes[3])["commanded"][:, 1] == pytest.approx(4.0)
    plt.close(sheet)


def test_where_nothing_was_heard_no_line_is_drawn(log):
    hole = (log.measured[:, 0] < START + 1.0) | (log.measured[:, 0] > START + 2.0)
    log.measured = log.measured[hole]
    sheet = bag_picture._wheels(log)
    drawn = lines(sheet.axes[1])["measured"]
    assert np.isnan(drawn).any(axis=1).sum() == 1
    plt.close(sheet)


def test_time_begins_with_the_recording(log):
    sheet = bag_picture._twist(log)
    left, right = sheet.axes[0].get_xlim()
    assert (left, right) == pytest.approx((0.0, END), abs=0.3)
    assert lines(sheet.axes[0])["odometry"][0, 0] == pytest.approx(0.0, abs=0.1)
    plt.close(sheet)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["/nowhere"], 1, "/nowhere is no recording"),
        (["--namespace", "robot3", "TWO"], 2, "no robot 'robot3' in it; there are robot1, robot2"),
        (["TWO"], 2, "several robots in it, choose by --namespace: robot1, robot2"),
        (["NONE"], 1, "no robot in it"),
    ],
)
def test_what_cannot_be_drawn_is_said(tmp_path, capsys, arguments, code, message):
    bags = {
        "TWO": [(1.0, f"/{name}/odom", s.odometry(1.0, (0, 0, 0))) for name in ("robot1",
                                                                              "robot2")],
        "NONE": [(1.0, "/rosout", s.text("hello"))],
    }  # fmt: skip
    given = [
        str(s.write(tmp_path / word, bags[word])) if word in bags else word for word in arguments
    ]
    assert main(["plot", *given, "--results", str(tmp_path / "pictures")]) == code
    assert message in capsys.readouterr().err
    assert not (tmp_path / "pictures").exists()


def test_pictures_are_opened_where_it_is_asked_for(drive, tmp_path, monkeypatch):
    file, opened = tmp_path / "way.png", []
    monkeypatch.setattr(bag_picture, "draw", lambda *_: {"way": file})
    monkeypatch.setattr(plot.webbrowser, "open", opened.append)
    args = argparse.Namespace(bag=str(drive), results=str(tmp_path), namespace="", show=False)
    assert plot.run(args) == 0
    assert opened == []
    args.show = True
    assert plot.run(args) == 0
    assert opened == [file.as_uri()]


def test_without_the_library_it_says_how_to_get_it(drive, monkeypatch, capsys):
    monkeypatch.setattr(plot.availability, "is_available", lambda: False)
    assert main(["plot", str(drive)]) == 1
    assert "pip install 'omniman_ros[record]'" in capsys.readouterr().err
