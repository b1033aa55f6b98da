"""`omniman reproduce tool_path`."""

import numpy as np
import pytest

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.parameters import build
from omniman_ros.lab.reproduce.tool_path import drive_row, report
from omniman_ros.lab.studies.tool_path import WHEELS, StreamedArm, ToolPathCase, ToolPathRun
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.simulation.ur.arm import SimulatedArm, UrArmParameters
from omniman_ros.ur.parameters import UrParameters


def made(off, peak, correction=True):
    """Return a synthetic drive with the given errors [m]."""
    count = 100
    wanted = np.zeros((count, 3))
    odom = wanted + [off, 0.0, 0.0]
    odom[50, 0] = peak
    case = ToolPathCase("S", WHEELS["PI"], build(ToolPathOptions, {"correction": correction}))
    times, zero = np.linspace(0.0, 1.0, count), np.zeros((count, 3))
    return ToolPathRun(case, times, wanted, odom, wanted, zero, zero, np.zeros(count))


@pytest.mark.parametrize(
    ("off", "peak", "kept"),
    [(0.0019, 0.0049, True), (0.0021, 0.002, False), (0.001, 0.0051, False)],
)
def test_drive_is_judged_by_mean_and_maximum_error(off, peak, kept):
    assert drive_row(made(off, peak))["kept"] is kept


def test_report_says_whether_the_bounds_are_kept():
    rows = [drive_row(made(0.001, 0.002)), drive_row(made(0.009, 0.01, correction=False))]
    result = {
        "drives": rows,
        "bounds": {"rms_mm": 2.0, "max_mm": 5.0},
        "passed": True,
    }
    assert "kept" in report(result)[-1]
    assert "MISSED" in report(result | {"passed": False})[-1]
    assert any(" off " in line for line in report(result))


def test_arm_is_in_time_with_its_lead_and_late_without():
    home = np.array([0.0, -1.9, 2.0, -1.7, -1.57, 0.0])

    def behind(**ur):
        body = SimulatedArm(UrArmParameters(initial=tuple(home)))
        arm = StreamedArm(body, ArmParameters(), UrParameters(**ur))
        for k in range(1, 200):
            now = 0.008 * k
            times = now + 0.008 * np.arange(30)
            way = np.where(times < 0.5, 0.3 * times**2, 0.3 * times - 0.075)
            rate = np.minimum(0.6 * times, 0.3)
            one = np.ones((1, 6))
            positions = home + way[:, None] * one
            arm.preview(times, positions, rate[:, None] * one, np.zeros((30, 6)), now)
            q = arm.cycle(now)
        return float((0.3 * now - 0.075 - (q - home).max()) / 0.3)

    assert abs(behind()) < 0.004
    assert behind(servo_lag=0.0) == pytest.approx(0.04, abs=0.004)
