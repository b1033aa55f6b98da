"""What all experiments share: their progress, the report, and the result."""

import argparse
import importlib
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from omniman_ros.console import results
from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import say, table

Item = TypeVar("Item")
#: A column's cells: a format of a row's values, or a function of the row
Cell = str | Callable[[Mapping[str, Any]], str]


def columns(rows: Iterable[Mapping[str, Any]], *layout: tuple[str, Cell]) -> list[str]:
    """Return the lines of a table; a column is its header and its cell."""
    cells = [tuple(header for header, _ in layout)]
    for row in rows:
        each = (cell.format(**row) if isinstance(cell, str) else cell(row) for _, cell in layout)
        cells.append(tuple(each))
    return table(cells)


def draw_picture(
    draw: Callable[[ModuleType, Path], None], path: Path, module: str = "figures"
) -> str | None:
    """Draw a PNG file with a module of `lab`; return its path, or None without matplotlib."""
    try:
        figures = importlib.import_module(f"omniman_ros.lab.{module}")
    except ImportError:
        return None
    draw(figures, path)
    return str(path)


class Experiment:
    """A run of `omniman reproduce`: its progress, its picture and its result."""

    def __init__(self, args: argparse.Namespace, about: str) -> None:
        self._args, self._started = args, time.monotonic()
        self._name = f"reproduce_{args.name}" + (f"_{args.world}" if args.world else "")
        self.progress = Progress()
        where = f", in the physics world on wheels '{args.world}'" if args.world else ""
        self.progress.headline(f"{about}, robot '{args.robot}'{where}")

    def collect(
        self, items: Iterable[Item], count: int, note: Callable[[list[Item]], str] = lambda _: ""
    ) -> list[Item]:
        """Return drives that are computed one after the other, and show the progress meanwhile."""
        collected: list[Item] = []
        self.progress.begin("drives")
        for item in items:
            collected.append(item)
            text = f"{len(collected)} of {count}{note(collected)}"
            self.progress.update(len(collected) / count, text)
        self.progress.end(f"{len(collected)} drives{note(collected)}")
        return collected

    def picture(
        self, draw: Callable[[ModuleType, Path], None], module: str = "figures"
    ) -> str | None:
        """Draw a PNG file with a module of `lab`; return its path, or None without matplotlib."""
        return draw_picture(draw, Path(self._args.results, f"{self._name}.png"), module)

    def publish(
        self, figures: Mapping[str, Any], report: Callable[[dict[str, Any]], list[str]]
    ) -> None:
        """Print the report of an experiment's figures, and publish them as JSON."""
        common = {key: getattr(self._args, key) for key in ("robot", "world", "quick", "seed")}
        result = {**common, **figures, "took_s": time.monotonic() - self._started}
        lines = report(result)
        if "picture" in result:
            lines.append(f"Picture: {result['picture'] or 'no matplotlib'}")
        say("\n".join(lines))
        results.publish(self._name, result, self._args.results)
