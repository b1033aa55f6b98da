"""`omniman reproduce handover`."""

from dataclasses import replace

import pytest

from omniman_ros.lab.reproduce.handover import cases, drive_row, report
from test.lab.studies.test_handover import made


@pytest.mark.parametrize(
    ("error", "kept"),
    [
        ((0.012, -0.015, 0.017), True),
        ((0.021, 0.0, 0.0), False),
        ((0.0, -0.021, 0.0), False),
        ((0.0, 0.0, -0.018), False),
    ],
)
def test_drive_is_judged_by_the_largest_errors(error, kept):
    assert drive_row(made(error))["kept"] is kept


def test_station_counts_only_as_long_as_it_is_to_be_kept_and_in_motion():
    run = made()
    assert drive_row(run)["kept"] is True
    assert drive_row(replace(run, kept_from=4.0))["kept"] is False
    assert drive_row(replace(run, leader=0.5 * run.leader))["kept"] is False


def test_robots_that_touch_before_the_judged_time_do_not_count():
    run = made()
    follower = run.follower.copy()
    follower[0] = run.leader[0]
    row = drive_row(replace(run, follower=follower))
    assert row["kept"] is False and row["least_gap_m"] < 0.0


def test_report_says_whether_the_bounds_are_kept_where_there_is_an_aim():
    rows = [drive_row(made()), drive_row(made()) | {"is_aim": False, "kept": False}]
    bounds = {"position_mm": 20.0, "heading_deg": 1.0}
    result = {"drives": rows, "bounds": bounds, "kept_s": 5.0, "speed_m_s": 0.3, "passed": True}
    lines = report(result)
    assert "kept" in lines[-1] and not any("MISSED" in line for line in lines)
    assert "MISSED" in report(result | {"passed": False})[-1]


def test_drives_with_an_aim_come_first():
    aims = [case.is_aim for case in cases(quick=False, seed=0)]
    assert aims == sorted(aims, reverse=True) and 0 < sum(aims) < len(aims)
    assert [case.is_aim for case in cases(quick=True, seed=0)] == [True]
