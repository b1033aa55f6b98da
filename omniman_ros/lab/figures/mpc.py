"""Pictures of the test cases of MPC 2021: snapshots as in its figures, and what was measured."""

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
    PLAN,
    TopView,
    draw_legend,
    end_of,
    frame_axes,
)
from omniman_ros.lab.studies.mpc_cases import Scene
from omniman_ros.lab.studies.planned_drives import PlannedDrive
from omniman_ros.lab.studies.roller_diagonals import roller_diagonals, steady_power

BARS = (
    ("energy_j", PLAN, "planner"),
    ("speed_only_j", CADET, "straight line, slower"),
    ("all_limits_j", MINT, "straight line, slower and softer"),
)
FRAMES = 10
"""Frame rate of an animation [1/s]."""
NEARBY = 1.2
"""Largest gap that is drawn [m]."""


def moments(scene: Scene, ride: PlannedDrive, count: int = 5) -> list[float]:
    """Return the times of the snapshots [s]: the scene's, or evenly spread over the drive."""
    if scene.snapshots:
        return list(scene.snapshots)
    return [end_of(ride) * (k + 0.6) / count for k in range(count)]


def draw_free(
    robot: Robot, scene: Scene, ride: PlannedDrive, result: dict[str, Any], path: Path
) -> None:
    """Draw Fig. 4 of MPC 2021, the robot's heading along its path, and the energies.

    Args:
        robot: The robot.
        scene: The free case.
        ride: The drive.
        result: The published result, for its `energy`.
        path: Path of the PNG file.
    """
    with figure_style():
        sheet = plt.figure(figsize=(12.0, 6.8), layout="constrained")
        grid = sheet.add_gridspec(1, 2, width_ratios=(1.15, 1))
        times = moments(scene, ride)
        left = grid[0].subgridspec(len(times), 1)
        view = TopView(robot, scene, ride)
        for i, time in enumerate(times):
            axes = sheet.add_subplot(left[i])
            view.draw(axes, time)
            frame_axes(axes, view.bounds(times), labels=i == len(times) - 1)
            axes.set_title(f"t = {time:g} s")
        right = grid[1].subgridspec(3, 1, height_ratios=(1.1, 1, 1.2))
        _travel_direction(sheet.add_subplot(right[0]), robot, ride)
        _power(sheet.add_subplot(right[1]), robot)
        _bars(sheet.add_subplot(right[2]), result["energy"])
        draw_legend(sheet, scene)
        save_figure(sheet, path)


def draw_case(
    robot: Robot, scene: Scene, ride: PlannedDrive, path: Path, count: int = 5, columns: int = 3
) -> None:
    """Draw snapshots of a drive among obstacles, as in Fig. 5 of MPC 2021, and the gaps kept.

    Args:
        robot: The robot.
        scene: The case.
        ride: The drive.
        path: Path of the PNG file.
        count: Number of snapshots where the scene has none.
        columns: Number of columns.
    """
    times = moments(scene, ride, count)
    view = TopView(robot, scene, ride)
    bounds = view.bounds(times)
    count = len(times)
    rows = math.ceil((count + 1) / columns)
    width = 12.0 / columns
    height = width * (bounds[3] - bounds[2]) / (bounds[1] - bounds[0]) + 0.55
    with figure_style():
        sheet = plt.figure(figsize=(12.0, rows * height + 0.3), layout="constrained")
        grid = sheet.add_gridspec(rows, columns)
        for i, time in enumerate(times):
            axes = sheet.add_subplot(grid[i // columns, i % columns])
            view.draw(axes, time)
            frame_axes(axes, bounds)
            axes.set_title(f"t = {time:.1f} s")
        right = sheet.add_subplot(grid[count // columns, count % columns :])
        _gaps(right, ride, times, len(scene.obstacles))
        draw_legend(sheet, scene, bool(view.moving.any()))
        save_figure(sheet, path)


def draw_trail(
    robot: Robot, scene: Scene, ride: PlannedDrive, path: Path, every: float = 0.8
) -> None:
    """Draw a drive through a building with the robot at intervals [s], and the gaps kept."""
    view = TopView(robot, scene, ride)
    bounds = view.bounds([0.0])
    with figure_style():
        ratio = (bounds[3] - bounds[2]) / (bounds[1] - bounds[0])
        sheet = plt.figure(figsize=(12.0, 12.0 * ratio + 2.2), layout="constrained")
        grid = sheet.add_gridspec(2, 1, height_ratios=(12.0 * ratio, 1.6))
        axes = sheet.add_subplot(grid[0])
        view.trail(axes, every)
        frame_axes(axes, bounds)
        _gaps(sheet.add_subplot(grid[1]), ride, [], len(scene.obstacles))
        save_figure(sheet, path)


def animate(robot: Robot, scene: Scene, ride: PlannedDrive, path: Path) -> None:
    """Draw a drive as a GIF that moves in real time."""
    times = np.arange(0.0, end_of(ride) + 1.0, 1.0 / FRAMES)
    view = TopView(robot, scene, ride)
    bounds = view.bounds([0.0, 0.5 * end_of(ride)])
    with figure_style():
        ratio = (bounds[3] - bounds[2]) / (bounds[1] - bounds[0])
        sheet, axes = plt.subplots(figsize=(7.0, 7.0 * ratio + 0.5), dpi=60, layout="constrained")

        def show(time: float) -> None:
            axes.clear()
            view.draw(axes, time)
            frame_axes(axes, bounds)
            axes.set_title(f"t = {time:.1f} s")

        # The layout is made once: this halves the time per frame, and no frame jumps.
        show(0.0)
        sheet.canvas.draw()
        sheet.set_layout_engine("none")
        film = FuncAnimation(sheet, show, frames=times.tolist(), init_func=lambda: None)
        path.parent.mkdir(parents=True, exist_ok=True)
        film.save(path, writer=PillowWriter(fps=FRAMES))
        plt.close(sheet)


def _travel_direction(axes: Any, robot: Robot, ride: PlannedDrive) -> None:
    """Draw the direction of travel in base_link over time."""
    times, angles = ride.drive.travel_directions()
    axes.plot(times, np.degrees(angles), color=INK, label="travel, in base_link")
    rotation = np.degrees(ride.drive.poses[:, 2] - ride.drive.poses[0, 2])
    axes.plot(ride.drive.times, rotation, color=RED, lw=1.0, label="heading")
    for k, diagonal in enumerate(np.degrees(roller_diagonals(robot))):
        axes.axhline(
            diagonal, color=GREY, ls="--", lw=0.8, label="roller diagonals" if k == 0 else None
        )
    axes.set_xlim(0.0, end_of(ride))
    axes.set_ylim(-100.0, 100.0)
    axes.set_yticks([-90, -45, 0, 45, 90])
    axes.set_xlabel("time [s]")
    axes.set_ylabel("angle [°]")
    axes.set_title("Does it turn to a roller diagonal?", pad=18)
    axes.legend(loc="lower left", ncols=3, bbox_to_anchor=(-0.02, 0.97), borderpad=0.1)


def _power(axes: Any, robot: Robot, speed: float = 0.85) -> None:
    directions = np.linspace(-90.0, 90.0, 361)
    axes.plot(directions, steady_power(robot, speed, np.radians(directions)), color=INK)
    for diagonal in np.degrees(roller_diagonals(robot)):
        axes.axvline(diagonal, color=GREY, ls="--", lw=0.8)
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(-90.0, 90.0)
    axes.set_xticks([-90, -45, 0, 45, 90])
    axes.set_xlabel("direction of travel in base_link [°]")
    axes.set_ylabel("power [W]")
    axes.set_title(f"Power that friction takes at {speed:g} m/s")


def _bars(axes: Any, rows: Sequence[dict[str, Any]]) -> None:
    """Draw the energies at equal arrival times."""
    place = np.arange(len(rows), dtype=float)
    table = np.array([[_number(row[name]) for name, _, _ in BARS] for row in rows])
    table = np.nan_to_num(table.reshape(-1, len(BARS)))
    used = [k for k in range(len(BARS)) if table[:, k].any()]
    for i, k in enumerate(used):
        shift = (i - 0.5 * (len(used) - 1)) * 0.8 / len(used)
        axes.bar(
            place + shift, table[:, k], width=0.75 / len(used), color=BARS[k][1], label=BARS[k][2]
        )
    tops = table.max(axis=1, initial=0.0)
    for x, top, row in zip(place, tops, rows, strict=True):
        if math.isfinite(_number(row["ratio"])):
            axes.text(x, top, f"{row['ratio']:.2f}", ha="center", va="bottom", fontsize=7.5)
    names = [f"{row['distance_m']:g} m\n{row['bearing_deg']:g}°" for row in rows]
    axes.set_xticks(place, names, fontsize=7.5 if len(rows) > 10 else 8.5)
    axes.set_ylabel("energy [J]")
    axes.set_ylim(0.0, 1.3 * max(float(tops.max(initial=0.0)), 1.0))
    axes.set_title("Energy at equal arrival times, and their ratio")
    axes.legend(loc="upper left", ncols=1)


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _gaps(axes: Any, ride: PlannedDrive, times: Sequence[float], obstacles: int) -> None:
    """Draw the true gaps to a number of obstacles, and to the walls, over time."""
    drive = ride.drive
    for k, gaps in enumerate(drive.gaps.T):
        near = np.where(gaps < NEARBY, gaps, np.nan)
        label = "walls" if k == obstacles else f"{k + 1}"
        axes.plot(drive.times, near, lw=1.2, label=label)
    for time in times:
        axes.axvline(time, color=FAINT, lw=0.8, zorder=0)
    axes.axhline(0.0, color=RED, lw=1.0)
    axes.set_xlim(0.0, end_of(ride))
    axes.set_ylim(min(-0.05, drive.clearance - 0.05), 1.25 * NEARBY)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("true gap [m]")
    axes.set_title(f"Least gap {1e3 * drive.clearance:.0f} mm")
    axes.legend(loc="upper center", ncols=4, handlelength=1.0, columnspacing=1.0, borderpad=0.1)
