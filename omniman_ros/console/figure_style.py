"""Colours and style of all figures, and the function that saves a figure.

Importing this module selects matplotlib's Agg back end, which needs no display. It raises
ImportError where matplotlib is not installed, so commands import it (and the modules that draw)
only when they are about to draw.
"""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot

INK = "#1f2933"  #: Colour of text and of the main line
GREY = "#5f6b7a"  #: Colour of ticks, annotations and secondary lines
NEUTRAL = "#7b8794"  #: Colour of filled outlines, such as the robot's
FAINT = "#c3cad2"  #: Colour of axes and of lines in the background
GRID = "#e4e7eb"  #: Colour of a grid that stays in the background
BLUE = "#2f6fde"
LIGHT_BLUE = "#bcd2f7"
CYAN = "#0891b2"
GREEN = "#0b8043"
MINT = "#a3c9a8"
GOLD = "#b8860b"
BRONZE = "#b86e00"
SAND = "#e9a23b"
ORANGE = "#d9480f"
RED = "#d62828"
PINK = "#d6009a"
MAGENTA = "#b5179e"
PURPLE = "#8a4fbf"
BROWN = "#8d6e63"
#: Colours of series that have no meaning of their own, in the order in which they are used
SERIES = (BLUE, ORANGE, GREEN, PURPLE, GOLD, CYAN, RED, GREY)
STYLE: dict[str, Any] = {
    "font.size": 9,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "figure.dpi": 130,
    "lines.linewidth": 1.4,
    "lines.markersize": 4,
    "legend.frameon": False,
    "legend.fontsize": 8,
}  #: matplotlib's parameters that all figures share


def figure_style(**changes: Any) -> AbstractContextManager[None]:
    """Apply the style to all figures that are made within a `with` block.

    Parameters of matplotlib that differ from `STYLE` are given as keywords, with `_` in place of
    `.`: `figure_style(lines_linewidth=1.2)`.
    """
    by_keyword = {name.replace(".", "_"): name for name in matplotlib.rcParams}
    named = {by_keyword.get(name, name): value for name, value in changes.items()}
    changed: dict[Any, Any] = {**STYLE, **named}
    context: AbstractContextManager[None] = pyplot.rc_context(changed)
    return context


def save_figure(figure: Any, path: Path) -> Path:
    """Save a figure in the format given by the file's suffix, and close it; return the path.

    The folder of the file is created if it does not exist.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        figure.savefig(path)
    finally:
        pyplot.close(figure)
    return path
