import os

import numpy as np
import pytest

from omniman_ros.console.errors import CommandError
from omniman_ros.lab import measurement
from omniman_ros.lab.measurement import columns_at, cpu_fractions, cpu_time


def test_cpu_time_agrees_with_the_system():
    own = os.times()
    assert cpu_time(os.getpid()) == pytest.approx(own.user + own.system, abs=0.05)


def test_cpu_share_is_cpu_time_over_time(monkeypatch):
    spent, clock = {7: 3.0, 9: 0.5}, [100.0]

    def serve():
        clock[0] += 10.0
        spent[7] += 10.0
        spent[9] += 2.5

    monkeypatch.setattr(measurement, "cpu_time", spent.get)
    monkeypatch.setattr(measurement.time, "monotonic", lambda: clock[0])
    assert cpu_fractions({"busy": 7, "idle": 9}, serve) == {"busy": 1.0, "idle": 0.25}


def test_cpu_time_of_a_missing_process_is_an_error():
    with pytest.raises(CommandError, match="process 999999999"):
        cpu_time(999999999)


def test_columns_are_interpolated_between_the_times_of_their_rows():
    rows = np.array([[0.0, 1.0, -1.0], [2.0, 3.0, -5.0]])
    assert columns_at(rows, np.array([0.5, 1.0])) == pytest.approx(
        np.array([[1.5, -2.0], [2.0, -3.0]])
    )
