"""Recordings of tables, written and read without ROS."""

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.recording.recordings import read_recording, write_recording
from omniman_ros.recording.robot_log import RobotLog

WHEELS = ("a", "b", "c")


def log():
    rows = np.random.default_rng(1).uniform(-1.0, 1.0, (4, 20))
    times = np.array([[1.5], [1.6], [1.7], [2.0]])
    motion, wheels = np.hstack([times, rows[:, :6]]), np.hstack([times, rows[:, 6:9]])
    return RobotLog(
        odom=motion, truth=motion + [0, 1, 1, 1, 0, 0, 0], wheel_names=WHEELS,
        angles=wheels, measured=np.hstack([times, rows[:, 9:12]]),
    )  # fmt: skip


def test_a_written_recording_is_read_as_it_was(tmp_path):
    written = log()
    read = read_recording(write_recording(tmp_path / "bag", written))
    assert read.wheel_names == WHEELS
    for table in ("odom", "truth", "angles", "measured"):
        assert getattr(read, table) == pytest.approx(getattr(written, table), abs=1e-9), table


def test_wheels_have_the_order_that_is_asked_for(tmp_path):
    written = log()
    path = write_recording(tmp_path / "bag", written)
    read = read_recording(path, ("c", "a", "b"))
    assert read.angles == pytest.approx(written.angles[:, [0, 3, 1, 2]])
    assert len(read_recording(path, ("c", "a", "x")).angles) == 0


def test_a_recording_without_the_robot_is_refused(tmp_path):
    with pytest.raises(InputError, match="no data of a robot"):
        read_recording(write_recording(tmp_path / "bag", log()), namespace="other")


def test_what_cannot_be_written_is_refused(tmp_path):
    path = write_recording(tmp_path / "bag", log())
    with pytest.raises(InputError, match=path):
        write_recording(path, log())
    unfit = log()
    unfit.angles = unfit.angles[1:]
    with pytest.raises(InputError, match=r"angles \(3, 4\), speeds \(4, 4\) and 3 names"):
        write_recording(tmp_path / "other", unfit)
