"""Motor constants at the wheels from voltages, currents and speeds, CCTA 2017 (22)."""

from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.identification.floor.floor_drive import FloorDrive
from omniman_ros.identification.floor.regressor import GRID_PERIOD
from omniman_ros.identification.floor.windows import Windows, resample, speeds


@dataclass(frozen=True, eq=False)
class MotorFit:
    """Constants of n motors."""

    back_emf: Array  #: (n,) constants K N at the wheel [V s/rad]
    resistance: Array  #: (n,) armature resistances [ohm]


def fit_motors(drive: FloorDrive, windows: Windows, kept: Array | None = None) -> MotorFit | None:
    """Fit U = R i + K N phi' to each motor; the inductance's mean voltage is negligible.

    Args:
        kept: (k,) flags of the windows to use; None for all.

    Returns:
        The fit; None if a drive does not report its voltage.
    """
    if not np.isfinite(drive.voltages).all():
        return None
    n = drive.wheel_count
    times, positions = resample(drive.times, drive.positions, GRID_PERIOD)
    rates = speeds(positions, GRID_PERIOD)
    at = np.column_stack([np.interp(drive.electrical_times, times, w) for w in rates.T])
    means = windows.mean(drive.electrical_times, np.hstack([drive.voltages, drive.currents, at]))
    if kept is not None:
        means = means[kept]
    voltage, current, speed = means[:, :n], means[:, n : 2 * n], means[:, 2 * n :]
    found = [
        np.linalg.lstsq(np.column_stack([current[:, k], speed[:, k]]), voltage[:, k], rcond=None)[
            0
        ]
        for k in range(n)
    ]
    resistance, back_emf = np.array(found).T
    return MotorFit(back_emf, resistance)
