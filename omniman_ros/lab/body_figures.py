"""Pictures of the whole body among obstacles, drawn with matplotlib."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D

from omniman_ros.console.figure_style import (
    BLUE,
    BRONZE,
    GREEN,
    GREY,
    INK,
    LIGHT_BLUE,
    NEUTRAL,
    ORANGE,
    PURPLE,
    RED,
    SAND,
    figure_style,
    save_figure,
)
from omniman_ros.lab.figures import (
    draw_ellipse,
    draw_robot,
    frame_axes,
    label_axes,
)
from omniman_ros.lab.studies.avoidance_scenes import AvoidanceScene, SceneGenerator
from omniman_ros.lab.studies.body_judge import JudgedBody

STRIP_COLUMNS = 2  #: of the film strip of a body that dodges
#: Fill and outline of what is in a scene
KIND_COLOURS = {"post": (GREY, INK), "table": (SAND, BRONZE), "person": (LIGHT_BLUE, BLUE)}
#: Colours of the body that dodges, and of what is driven beside
DRIVE_COLOURS = (GREEN, PURPLE, RED, ORANGE)
ROUND_WAYS = 0.8  #: margin around the ways from above [m]
AFTER = 1.0  #: time that is shown after the end [s]
LONGEST_RATIO = 2.5  #: largest duration that is shown, over the unhindered one


def draw_dodge(
    generator: SceneGenerator,
    scene: AvoidanceScene,
    drives: Mapping[str, JudgedBody],
    bounds: tuple[float, float],
    path: Path,
) -> None:
    """Draw drives of a scene as a PNG file: a film strip of the first, and figures over time.

    The strip shows the instants at which each thing is nearest to the first drive, and its end.

    Args:
        bounds: Bounds of the RMS and of the maximum of the tool's error [m].
    """
    drive, *_ = drives.values()
    kinds = [_kind(scene, number) for number in range(len(scene.things))]
    nearest = zip(drive.gaps.argmin(axis=0).tolist(), kinds, drive.gaps.min(axis=0), strict=True)
    titles = {k: f"{kind} at {1e3 * gap:.0f} mm" for k, kind, gap in nearest}
    titles = {**titles, len(drive.times) - 1: "the end"}
    rows = math.ceil(len(titles) / STRIP_COLUMNS)
    points = np.vstack([drive.axes[:, :2], drive.due[:, :2]])
    low, high = points.min(axis=0) - ROUND_WAYS, points.max(axis=0) + ROUND_WAYS
    height = 13.0 / STRIP_COLUMNS * (high[1] - low[1]) / (high[0] - low[0]) + 0.25
    with figure_style():
        figure = plt.figure(figsize=(13.0, rows * height + 3.0), layout="constrained")
        grid = figure.add_gridspec(rows + 1, STRIP_COLUMNS, height_ratios=[height] * rows + [2.4])
        for i, (k, title) in enumerate(sorted(titles.items())):
            row, column = divmod(i, STRIP_COLUMNS)
            axes = figure.add_subplot(grid[row, column])
            _draw_things(axes, scene, float(drive.times[k]))
            _body_from_above(axes, generator, list(drives.values()), k)
            frame_axes(axes, (low[0], high[0], low[1], high[1]))
            axes.tick_params(labelbottom=row == rows - 1, labelleft=column == 0)
            axes.set_xlabel("x [m]" if row == rows - 1 else "")
            axes.set_ylabel("y [m]" if column == 0 else "")
            axes.set_title(f"t = {drive.times[k]:.1f} s: {title}")
        errors, speeds = (figure.add_subplot(grid[rows, column]) for column in (0, -1))
        errors.plot(drive.cycles, 1e3 * drive.off, color=GREEN, lw=0.8)
        for bound in bounds:
            errors.axhline(1e3 * bound, color=GREY, lw=0.8, ls="--")
        found = zip(("RMS", "max"), (drive.rms, drive.off.max()), bounds, strict=True)
        text = ", ".join(f"{n} {1e3 * is_:.2f}, aim {1e3 * aim:g}" for n, is_, aim in found)
        label_axes(errors, f"Error of the tool as the body avoids [mm]: {text}", "time [s]")
        _dodge_speeds(speeds, drives)
        for axes in (errors, speeds):
            axes.set_xlim(0.0, drive.cycles[-1] + AFTER)
            axes.set_ylim(bottom=0.0)
        _dodge_legend(figure, kinds, list(drives))
        save_figure(figure, path)


def _kind(scene: AvoidanceScene, number: int) -> str:
    """Return the kind of a thing: who moves is a person, what begins above the floor a table."""
    if np.any(scene.velocities[number]):
        return "person"
    return "table" if scene.things[number].heights[0] > 0.0 else "post"


def _draw_things(axes: Any, scene: AvoidanceScene, now: float) -> None:
    """Draw what is in a scene at a time [s], with the way of who walks in the next second."""
    for k, place in enumerate(scene.places_at(now)):
        kind, thing = _kind(scene, k), scene.things[k]
        face, edge = KIND_COLOURS[kind]
        draw_ellipse(axes, place, thing.semi_axes, thing.angle, fc=face, ec=edge, lw=0.8, zorder=2)
        if kind == "person":
            arrow = {"arrowstyle": "-|>", "color": edge, "shrinkA": 0.0, "shrinkB": 0.0}
            note = axes.annotate("", place + scene.velocities[k], place, arrowprops=arrow)
            note.arrow_patch.set_clip_path(axes.patch)


def _body_from_above(
    axes: Any, generator: SceneGenerator, drives: Sequence[JudgedBody], k: int
) -> None:
    """Draw the first robot and its ways at the instant with a number, the others as outlines."""
    model, body = generator.model, generator.setup.description.robot
    drive, *others = drives
    for other, colour in zip(others, DRIVE_COLOURS[1:], strict=False):
        draw_robot(axes, body, other.axes[min(k, len(other.axes) - 1), :3], colour)
    axes.plot(*drive.axes[: k + 1, :2].T, color=NEUTRAL, lw=1.0, zorder=3)
    axes.plot(*drive.due[[0, -1], :2].T, color=GREEN, lw=0.8, zorder=3)
    axes.plot(*drive.tool[: k + 1, :2].T, color=GREEN, lw=2.4, zorder=5)
    draw_robot(axes, body, drive.axes[k, :3], NEUTRAL, fill=0.45)
    links = (model.base(drive.axes[k, :3]) @ model.arm.frames(drive.axes[k, 3:]))[:, :2, 3]
    axes.plot(*links.T, color=ORANGE, lw=3.0, zorder=6, solid_capstyle="round")
    axes.plot(*links.T, "o", color=INK, ms=2.5, zorder=7)
    axes.plot(*drive.tool[k, :2], "o", color=GREEN, ms=5.0, zorder=8)


def _dodge_speeds(axes: Any, drives: Mapping[str, JudgedBody]) -> None:
    """Draw the tool's speed along its path, and the first contact of each drive."""
    for (name, drive), colour in zip(drives.items(), DRIVE_COLOURS, strict=False):
        speeds = drive.speeds()
        axes.plot(drive.cycles, speeds, color=colour, lw=1.2, label=name)
        touched = min(drive.contacts() + drive.contacts(at_rest=True), default=None)
        if touched is not None:
            speed = np.interp(touched, drive.cycles, speeds)
            axes.plot(
                touched, speed, "X", color=colour, ms=9, mec="white", clip_on=False, zorder=5
            )
    label_axes(axes, "Speed along the path [m/s]; crosses: first contact", "time [s]")
    axes.legend(loc="center", bbox_to_anchor=(0.6, 0.5))


def _dodge_legend(figure: Any, kinds: Sequence[str], names: Sequence[str]) -> None:
    """Draw the legend of the film strip."""
    disc: dict[str, Any] = {"marker": "o", "ls": "", "ms": 8}
    words = {"table": "table, lower than the tool", "person": "person, arrow: the next second"}
    handles = [
        Line2D([], [], color=face, mec=edge, label=words.get(kind, kind), **disc)
        for kind, (face, edge) in KIND_COLOURS.items()
        if kind in kinds
    ]
    handles += [
        Line2D([], [], color=ORANGE, lw=3.0, label="arm"),
        Line2D([], [], color=GREEN, lw=2.4, label="tool on its path"),
        Line2D([], [], color=NEUTRAL, lw=1.0, label="platform"),
    ]
    outline: dict[str, Any] = {"mfc": "none", "marker": "s", "ls": "", "ms": 7}
    handles += [
        Line2D([], [], color=colour, label=name, **outline)
        for name, colour in zip(names[1:], DRIVE_COLOURS[1:], strict=False)
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=len(handles))


def draw_outcomes(
    groups: Mapping[str, Mapping[str, Mapping[str, Any]]], aims: Mapping[str, float], path: Path
) -> None:
    """Draw which fraction of scenes each method completes within a time, as a PNG file.

    Args:
        groups: Summaries with `scenes` and `time_ratios` of each method, for each group of scenes.
        aims: The fraction to complete within the aimed time of each group that has one.
    """
    with figure_style():
        figure, parts = plt.subplots(
            1, len(groups), figsize=(11.0, 3.6), sharey=True, layout="constrained"
        )
        for axes, (group, methods) in zip(np.atleast_1d(parts), groups.items(), strict=True):
            for (name, each), colour in zip(methods.items(), DRIVE_COLOURS, strict=True):
                ratios = np.sort(each["time_ratios"])
                fractions = np.arange(1, len(ratios) + 1) / each["scenes"]
                axes.step(
                    [1.0, *ratios, LONGEST_RATIO],
                    [0.0, *fractions, fractions[-1] if len(fractions) else 0.0],
                    where="post",
                    color=colour,
                    label=f"{name}: {len(ratios)} of {each['scenes']}",
                )
            if group in aims:
                axes.plot(1.3, aims[group], "k+", ms=10, label="aim")
            axes.set_xlim(1.0, LONGEST_RATIO)
            axes.set_ylim(0.0, 1.02)
            label_axes(axes, group.capitalize(), "time over that with nothing around")
            axes.legend(loc="lower right")
        np.atleast_1d(parts)[0].set_ylabel("completed without contact")
        save_figure(figure, path)
