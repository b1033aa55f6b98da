"""What all examples end with: figures on the terminal, and a picture on the screen or in a file.

python examples/NN_name.py             shows the picture, or writes it where there is no display
python examples/NN_name.py --no-show   writes NN_name.png
"""

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

from matplotlib import pyplot

DARK, LIGHT, GREY = "#1f4e8c", "#e69a2e", "#9aa3ad"  #: Colours that also differ in grey
INK = "#1f2933"  #: Colour of text and outlines

pyplot.rcParams.update(
    {
        "figure.constrained_layout.use": True,
        "figure.dpi": 110,
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.edgecolor": GREY,
        "axes.labelcolor": INK,
        "axes.titlesize": 9,
        "legend.frameon": False,
    }
)


def finish(figures: Mapping[str, float]) -> None:
    """Print the figures of an example, one a line, and show its picture or write it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--no-show", action="store_true", help="write the picture as a file")
    parser.add_argument("--output", type=Path, default=Path(), help="folder of that file")
    arguments, _ = parser.parse_known_args()
    for name, value in figures.items():
        print(f"{name} = {value:.4g}")
    if pyplot.get_backend().lower() != "agg" and not arguments.no_show:
        pyplot.show()
        return
    path = arguments.output / f"{Path(sys.argv[0]).stem}.png"
    pyplot.savefig(path)
    print(f"the picture is {path}")
