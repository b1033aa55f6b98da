"""Pictures of the test cases of MPC 2021: snapshots as in the paper, and measured gaps."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from omniman_ros.console.figure_style import FAINT, RED, figure_style, save_figure
from omniman_ros.core.robot import Robot
from omniman_ros.lab.figures.top_view import TopView, draw_legend, end_of, frame_axes
from omniman_ros.lab.studies.mpc_cases import Scene
from omniman_ros.lab.studies.planned_drives import PlannedDrive

COLUMNS = 3
SNAPSHOTS = 5  # where the scene defines none
TRAIL_INTERVAL = 0.8  # time between two drawings of the robot on a trail [s]
MAX_GAP = 1.2  # largest gap that is drawn [m]


def draw_snapshots(robot: Robot, scene: Scene, planned: PlannedDrive, path: Path) -> None:
    """Draw snapshots of a drive as a PNG file, as in Fig. 4 and 5 of MPC 2021, and its gaps."""
    evenly = [end_of(planned) * (k + 0.6) / SNAPSHOTS for k in range(SNAPSHOTS)]
    times = list(scene.snapshots) or evenly
    view = TopView(robot, scene, planned)
    bounds = view.bounds(times)
    rows = math.ceil((len(times) + 1) / COLUMNS)
    width = 12.0 / COLUMNS
    height = width * (bounds[3] - bounds[2]) / (bounds[1] - bounds[0]) + 0.55
    with figure_style():
        figure = plt.figure(figsize=(12.0, rows * height + 0.3), layout="constrained")
        grid = figure.add_gridspec(rows, COLUMNS)
        for i, time in enumerate(times):
            axes = figure.add_subplot(grid[i // COLUMNS, i % COLUMNS])
            view.draw(axes, time)
            frame_axes(axes, bounds)
            axes.set_title(f"t = {time:.1f} s")
        last = figure.add_subplot(grid[len(times) // COLUMNS, len(times) % COLUMNS :])
        _gaps(last, planned, times, len(scene.obstacles))
        draw_legend(figure)
        save_figure(figure, path)


def draw_trail(robot: Robot, scene: Scene, planned: PlannedDrive, path: Path) -> None:
    """Draw a drive through a building as a PNG file, and its gaps."""
    view = TopView(robot, scene, planned)
    bounds = view.bounds([0.0])
    height = 12.0 * (bounds[3] - bounds[2]) / (bounds[1] - bounds[0])
    with figure_style():
        figure = plt.figure(figsize=(12.0, height + 2.2), layout="constrained")
        grid = figure.add_gridspec(2, 1, height_ratios=(height, 1.6))
        axes = figure.add_subplot(grid[0])
        view.draw_trail(axes, TRAIL_INTERVAL)
        frame_axes(axes, bounds)
        _gaps(figure.add_subplot(grid[1]), planned, [], len(scene.obstacles))
        save_figure(figure, path)


def _gaps(axes: Any, planned: PlannedDrive, times: Sequence[float], obstacles: int) -> None:
    """Draw the true gaps over time; a column beyond those of obstacles is that of the walls."""
    drive = planned.drive
    for k, gaps in enumerate(drive.gaps.T):
        near = np.where(gaps < MAX_GAP, gaps, np.nan)
        axes.plot(drive.times, near, lw=1.2, label="walls" if k == obstacles else f"{k + 1}")
    for time in times:
        axes.axvline(time, color=FAINT, lw=0.8, zorder=0)
    axes.axhline(0.0, color=RED, lw=1.0)
    axes.set_xlim(0.0, end_of(planned))
    axes.set_ylim(min(-0.05, drive.clearance - 0.05), 1.25 * MAX_GAP)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("true gap [m]")
    if drive.gaps.shape[1]:
        axes.set_title(f"Least gap {1e3 * drive.clearance:.0f} mm")
        axes.legend(loc="upper center", ncols=4, handlelength=1.0, columnspacing=1.0)
