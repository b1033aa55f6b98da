"""Pictures of the test cases of MPC 2021: snapshots as in the paper, and measured quantities."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.animation import FuncAnimation, PillowWriter

from omniman_ros.console.figure_style import (
    CADET,
    FAINT,
    GREY,
    INK,
    MINT,
    RED,
    figure_style,
    save_figure,
)
from omniman_ros.core.robot import Robot
from omniman_ros.lab.figures.top_view import (
    PLAN_COLOUR,
    TopView,
    draw_legend,
    end_of,
    frame_axes,
)
from omniman_ros.lab.studies.mpc_cases import Scene
from omniman_ros.lab.studies.planned_drives import PlannedDrive
from omniman_ros.lab.studies.roller_diagonals import roller_diagonals, steady_power

ENERGY_BARS = (
    ("energy_j", PLAN_COLOUR, "planner"),
    ("speed_only_j", CADET, "straight line, slower"),
    ("all_limits_j", MINT, "straight line, slower and softer"),
)
"""Key in the results, colour and label of each kind of bar in the chart of energies."""
FRAME_RATE = 10
"""Frame rate of an animation [1/s]."""
MAX_GAP = 1.2
"""Largest gap that is drawn [m]."""


def snapshot_times(scene: Scene, planned: PlannedDrive, count: int = 5) -> list[float]:
    """Return the times of the snapshots, which the scene defines or which are spread evenly.

    Args:
        scene: The scene.
        planned: The drive.
        count: Number of snapshots if the scene defines none.

    Returns:
        Times since the robot was sent off [s].
    """
    if scene.snapshots:
        return list(scene.snapshots)
    return [end_of(planned) * (k + 0.6) / count for k in range(count)]


def draw_free(
    robot: Robot, scene: Scene, planned: PlannedDrive, result: dict[str, Any], path: Path
) -> None:
    """Draw the free case as a PNG file: Fig. 4 of MPC 2021, travel direction, power and energies.

    Args:
        robot: The robot.
        scene: The free case.
        planned: The drive.
        result: The result of the experiment, for its `energy`.
        path: Path of the PNG file.
    """
    with figure_style():
        figure = plt.figure(figsize=(12.0, 6.8), layout="constrained")
        grid = figure.add_gridspec(1, 2, width_ratios=(1.15, 1))
        times = snapshot_times(scene, planned)
        left = grid[0].subgridspec(len(times), 1)
        view = TopView(robot, scene, planned)
        for i, time in enumerate(times):
            axes = figure.add_subplot(left[i])
            view.draw(axes, time)
            frame_axes(axes, view.bounds(times), labels=i == len(times) - 1)
            axes.set_title(f"t = {time:g} s")
        right = grid[1].subgridspec(3, 1, height_ratios=(1.1, 1, 1.2))
        _travel_direction(figure.add_subplot(right[0]), robot, planned)
        _power(figure.add_subplot(right[1]), robot)
        _energy_bars(figure.add_subplot(right[2]), result["energy"])
        draw_legend(figure, scene)
        save_figure(figure, path)


def draw_case(
    robot: Robot, scene: Scene, planned: PlannedDrive, path: Path, count: int = 5, columns: int = 3
) -> None:
    """Draw snapshots of a drive among obstacles, as in Fig. 5 of MPC 2021, and its gaps.

    Args:
        robot: The robot.
        scene: The case.
        planned: The drive.
        path: Path of the PNG file.
        count: Number of snapshots if the scene defines none.
        columns: Number of columns of the picture.
    """
    times = snapshot_times(scene, planned, count)
    view = TopView(robot, scene, planned)
    bounds = view.bounds(times)
    count = len(times)
    rows = math.ceil((count + 1) / columns)
    width = 12.0 / columns
    height = width * (bounds[3] - bounds[2]) / (bounds[1] - bounds[0]) + 0.55
    with figure_style():
        figure = plt.figure(figsize=(12.0, rows * height + 0.3), layout="constrained")
        grid = figure.add_gridspec(rows, columns)
        for i, time in enumerate(times):
            axes = figure.add_subplot(grid[i // columns, i % columns])
            view.draw(axes, time)
            frame_axes(axes, bounds)
            axes.set_title(f"t = {time:.1f} s")
        right = figure.add_subplot(grid[count // columns, count % columns :])
        _gaps(right, planned, times, len(scene.obstacles))
        draw_legend(figure, scene, bool(view.moving.any()))
        save_figure(figure, path)


def draw_trail(
    robot: Robot, scene: Scene, planned: PlannedDrive, path: Path, interval: float = 0.8
) -> None:
    """Draw a drive through a building, with the robot at regular intervals, and its gaps.

    Args:
        robot: The robot.
        scene: The scene.
        planned: The drive.
        path: Path of the PNG file.
        interval: Time between two drawings of the robot [s].
    """
    view = TopView(robot, scene, planned)
    bounds = view.bounds([0.0])
    with figure_style():
        ratio = (bounds[3] - bounds[2]) / (bounds[1] - bounds[0])
        figure = plt.figure(figsize=(12.0, 12.0 * ratio + 2.2), layout="constrained")
        grid = figure.add_gridspec(2, 1, height_ratios=(12.0 * ratio, 1.6))
        axes = figure.add_subplot(grid[0])
        view.draw_trail(axes, interval)
        frame_axes(axes, bounds)
        _gaps(figure.add_subplot(grid[1]), planned, [], len(scene.obstacles))
        save_figure(figure, path)


def animate(robot: Robot, scene: Scene, planned: PlannedDrive, path: Path) -> None:
    """Draw a drive as an animated GIF that plays in real time.

    Args:
        robot: The robot.
        scene: The scene.
        planned: The drive.
        path: Path of the GIF file.
    """
    times = np.arange(0.0, end_of(planned) + 1.0, 1.0 / FRAME_RATE)
    view = TopView(robot, scene, planned)
    bounds = view.bounds([0.0, 0.5 * end_of(planned)])
    with figure_style():
        ratio = (bounds[3] - bounds[2]) / (bounds[1] - bounds[0])
        figure, axes = plt.subplots(figsize=(7.0, 7.0 * ratio + 0.5), dpi=60, layout="constrained")

        def draw_frame(time: float) -> None:
            axes.clear()
            view.draw(axes, time)
            frame_axes(axes, bounds)
            axes.set_title(f"t = {time:.1f} s")

        # A fixed layout halves the time per frame, and keeps the axes in the same place.
        draw_frame(0.0)
        figure.canvas.draw()
        figure.set_layout_engine("none")
        film = FuncAnimation(figure, draw_frame, frames=times.tolist(), init_func=lambda: None)
        path.parent.mkdir(parents=True, exist_ok=True)
        film.save(path, writer=PillowWriter(fps=FRAME_RATE))
        plt.close(figure)


def _travel_direction(axes: Any, robot: Robot, planned: PlannedDrive) -> None:
    """Draw the direction of travel in base_link and the robot's rotation over time."""
    times, angles = planned.drive.travel_directions()
    axes.plot(times, np.degrees(angles), color=INK, label="travel, in base_link")
    rotation = np.degrees(planned.drive.poses[:, 2] - planned.drive.poses[0, 2])
    axes.plot(planned.drive.times, rotation, color=RED, lw=1.0, label="heading")
    for k, diagonal in enumerate(np.degrees(roller_diagonals(robot))):
        axes.axhline(
            diagonal, color=GREY, ls="--", lw=0.8, label="roller diagonals" if k == 0 else None
        )
    axes.set_xlim(0.0, end_of(planned))
    axes.set_ylim(-100.0, 100.0)
    axes.set_yticks([-90, -45, 0, 45, 90])
    axes.set_xlabel("time [s]")
    axes.set_ylabel("angle [°]")
    axes.set_title("Does the robot turn to a roller diagonal?", pad=18)
    axes.legend(loc="lower left", ncols=3, bbox_to_anchor=(-0.02, 0.97), borderpad=0.1)


def _power(axes: Any, robot: Robot, speed: float = 0.85) -> None:
    """Draw the power that friction consumes at a constant speed [m/s], by direction of travel."""
    directions = np.linspace(-90.0, 90.0, 361)
    axes.plot(directions, steady_power(robot, speed, np.radians(directions)), color=INK)
    for diagonal in np.degrees(roller_diagonals(robot)):
        axes.axvline(diagonal, color=GREY, ls="--", lw=0.8)
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(-90.0, 90.0)
    axes.set_xticks([-90, -45, 0, 45, 90])
    axes.set_xlabel("direction of travel in base_link [°]")
    axes.set_ylabel("power [W]")
    axes.set_title(f"Power consumed by friction at {speed:g} m/s")


def _energy_bars(axes: Any, rows: Sequence[dict[str, Any]]) -> None:
    """Draw the energies to each goal at equal arrival times; missing values leave gaps."""
    positions = np.arange(len(rows), dtype=float)
    table = np.array([[_number(row[name]) for name, _, _ in ENERGY_BARS] for row in rows])
    table = np.nan_to_num(table.reshape(-1, len(ENERGY_BARS)))
    used = [k for k in range(len(ENERGY_BARS)) if table[:, k].any()]
    for i, k in enumerate(used):
        shift = (i - 0.5 * (len(used) - 1)) * 0.8 / len(used)
        axes.bar(
            positions + shift,
            table[:, k],
            width=0.75 / len(used),
            color=ENERGY_BARS[k][1],
            label=ENERGY_BARS[k][2],
        )
    tops = table.max(axis=1, initial=0.0)
    for x, top, row in zip(positions, tops, rows, strict=True):
        if math.isfinite(_number(row["ratio"])):
            axes.text(x, top, f"{row['ratio']:.2f}", ha="center", va="bottom", fontsize=7.5)
    names = [f"{row['distance_m']:g} m\n{row['bearing_deg']:g}°" for row in rows]
    axes.set_xticks(positions, names, fontsize=7.5 if len(rows) > 10 else 8.5)
    axes.set_ylabel("energy [J]")
    axes.set_ylim(0.0, 1.3 * max(float(tops.max(initial=0.0)), 1.0))
    axes.set_title("Energy at equal arrival times, and their ratio")
    axes.legend(loc="upper left", ncols=1)


def _number(value: Any) -> float:
    """Return a value from JSON as a number; null, which stands for a missing value, as NaN."""
    return math.nan if value is None else float(value)


def _gaps(axes: Any, planned: PlannedDrive, times: Sequence[float], obstacles: int) -> None:
    """Draw the true gaps to the obstacles and to the walls over time.

    Args:
        axes: Axes to draw on.
        planned: The drive.
        times: Times to mark with a vertical line [s].
        obstacles: Number of obstacles; a further column of gaps is that of the walls.
    """
    drive = planned.drive
    for k, gaps in enumerate(drive.gaps.T):
        near = np.where(gaps < MAX_GAP, gaps, np.nan)
        label = "walls" if k == obstacles else f"{k + 1}"
        axes.plot(drive.times, near, lw=1.2, label=label)
    for time in times:
        axes.axvline(time, color=FAINT, lw=0.8, zorder=0)
    axes.axhline(0.0, color=RED, lw=1.0)
    axes.set_xlim(0.0, end_of(planned))
    axes.set_ylim(min(-0.05, drive.clearance - 0.05), 1.25 * MAX_GAP)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("true gap [m]")
    axes.set_title(f"Least gap {1e3 * drive.clearance:.0f} mm")
    axes.legend(loc="upper center", ncols=4, handlelength=1.0, columnspacing=1.0, borderpad=0.1)
