from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.lab.studies.body_judge import REACH, STEP, JudgedBody


def made(rate=0.1, touches=(), gaps=None, off=0.0, peak=0.0, completed_at=1.0):
    """Return a drive ahead, 1 s at a rate [m/s], touched at numbers of instants."""
    times = np.arange(0.0, 1.0, STEP)
    still, cycles = np.zeros_like(times), np.arange(0.0, 1.0, 0.008)
    errors = np.full_like(cycles, off)
    errors[7] = peak or off
    return JudgedBody(
        times=times,
        axes=np.column_stack([rate * times, *np.zeros((8, len(times)))]),
        tool=np.column_stack([rate * times, still, still]),
        gaps=np.full((len(times), 1), 0.3) if gaps is None else gaps,
        touches=np.isin(np.arange(len(times)), touches).astype(float),
        cycles=cycles,
        due=np.outer(cycles, [0.0, 0.6 * rate, 0.8 * rate]),
        off=errors,
        stop="",
        completed_at=completed_at,
    )


@pytest.mark.parametrize("rate", [0.1, 0.0])
def test_a_contact_counts_once_where_it_begins_in_motion_or_at_rest(rate):
    drive = made(rate, touches=(0, 10, 11, 12, 20))
    begins = [0.0, 10 * STEP, 20 * STEP]
    assert drive.contacts() == pytest.approx(begins if rate else [])
    assert drive.contacts(at_rest=True) == pytest.approx([] if rate else begins)


@pytest.mark.parametrize("axis", [1, 2, 5])
def test_a_robot_moves_by_any_of_its_axes_and_in_either_direction(axis):
    drive = made(0.0, touches=(10,))
    axes = np.outer(-0.1 * drive.times, np.eye(9)[axis])
    drive = replace(drive, axes=axes)
    assert drive.contacts() and not drive.contacts(at_rest=True)


def test_figures_are_those_of_the_tool_along_its_path_and_of_the_nearest_thing():
    drive = made(0.2, off=0.001)
    assert drive.speeds() == pytest.approx(0.2)
    assert drive.rms == pytest.approx(0.001)
    assert drive.least_gap == pytest.approx(0.3)
    assert made(gaps=np.zeros((round(1.0 / STEP), 0))).least_gap == REACH
