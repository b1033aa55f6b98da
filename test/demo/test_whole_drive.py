"""Figures of the whole demo: odometry's drift, the timing of topics, and contacts."""

import math

import numpy as np
import pytest

from omniman_ros.demo.limits import violations
from omniman_ros.demo.recorder import Recording
from omniman_ros.demo.whole_drive import (
    WHOLE_DRIVE_LIMITS,
    drift_figures,
    interval_figures,
    whole_drive_figures,
)


def test_drift_compares_motions_whatever_the_frames():
    t = np.linspace(0.0, 1.0, 50)
    truth = np.column_stack([t, 2.0 * t, np.zeros(50), np.zeros(50)])
    c, s = math.cos(1.0), math.sin(1.0)
    odom = np.column_stack([t, 5 + c * 2.1 * t, 7 + s * 2.1 * t, 1.0 + 0.1 * t])
    result = drift_figures(odom, truth)
    assert result["position_mm"] == pytest.approx(100.0)
    assert result["heading_deg"] == pytest.approx(math.degrees(0.1))
    assert result["travel_m"] == pytest.approx(2.0)
    assert result["turn_rad"] == pytest.approx(0.0)


def test_the_longest_interval_shows_a_gap():
    result = interval_figures([0.0, 0.01, 0.02, 0.08, 0.09])
    assert result["max_ms"] == pytest.approx(60.0)
    assert result["p50_ms"] == pytest.approx(10.0)
    assert result["rate_hz"] == pytest.approx(4 / 0.09)


def figures_with(contacts):
    times = [0.005 * k for k in range(10)]
    rows = [(t, 0.1 * t, 0.0, 0.0) for t in times]
    recording = Recording(odom=rows, truth=rows, energy=[(0.0,), (1.0,)], contacts=contacts)
    recording.commands = times
    return whole_drive_figures(recording)


def test_any_contact_in_a_world_is_a_fault():
    assert violations(figures_with([]), WHOLE_DRIVE_LIMITS) == []
    touched = figures_with(["base_link, post"])
    assert touched["contacts"] == {"count": 1, "with": ["base_link, post"]}
    (fault,) = violations(touched, WHOLE_DRIVE_LIMITS)
    assert "touched: 1, at most 0" in fault


def test_without_a_world_there_is_no_figure_of_contacts():
    assert "contacts" not in figures_with(None)
