"""Sphinx extension: pages and tables that are made from the code and from results.

Directives:

* ``parameters NODE``: the parameters of a node, without those that describe the robot.
* ``robot-parameters``: the parameters that describe the robot, which all nodes share.
* ``lab COMMAND``: the table of what `omniman bench` or `omniman reproduce` runs.
* ``faults``: the table of faults that `omniman bench faults` plays.
* ``listening-sockets``: the table of sockets on which the robot listens.
* ``figures NAME``: the table of ``results/NAME.json``.

Before the build, a page for each example is written to ``examples/``, and the changelog is copied
from the root of the repository.
"""

import ast
import importlib.util
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx.ext.autodoc.mock import mock
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

OPTIONAL = [
    "action_msgs",
    "ament_index_python",
    "builtin_interfaces",
    "can",
    "canopen",
    "casadi",
    "control_msgs",
    "diagnostic_msgs",
    "geometry_msgs",
    "lark",
    "launch",
    "launch_ros",
    "lifecycle_msgs",
    "map_msgs",
    "matplotlib",
    "msgpack",
    "nav2_msgs",
    "nav_msgs",
    "rcl_interfaces",
    "rclpy",
    "rosbags",
    "rosgraph_msgs",
    "rosidl_runtime_py",
    "scipy",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "tf2_msgs",
    "trajectory_msgs",
    "viser",
    "visualization_msgs",
    "websockets",
]
"""Libraries that are replaced by stand-ins where they are not installed."""


class Table(SphinxDirective):
    """Parses generated Markdown in place, and gives its tables a class for the style sheet."""

    optional_arguments = 1
    style = "figures"

    def lines(self) -> Iterator[str]:
        """Yield the Markdown."""
        raise NotImplementedError

    def run(self) -> list[nodes.Node]:
        """Return the parsed Markdown."""
        container = nodes.container()
        source = StringList(list(self.lines()), source=type(self).__name__)
        self.state.nested_parse(source, self.content_offset, container)
        for table in container.findall(nodes.table):
            table["classes"].append(self.style)
        return container.children


class Parameters(Table):
    """The parameters of a node, without those that describe the robot."""

    style = "parameters"

    def lines(self) -> Iterator[str]:
        """Yield the table of the node's own parameters."""
        with mock(self.config.autodoc_mock_imports):
            from omniman_ros.nodes import registry

            self.env.note_dependency(registry.__file__)
            yield from registry.markdown(self.arguments[0], robot=False)


class RobotParameters(Table):
    """The parameters that describe the robot."""

    style = "parameters"

    def lines(self) -> Iterator[str]:
        """Yield the table of the robot's parameters."""
        with mock(self.config.autodoc_mock_imports):
            from omniman_ros.nodes import registry

            yield from registry.markdown(next(iter(registry.NODES)), robot=True)


class Lab(Table):
    """The table of the benchmarks or of the experiments."""

    style = "commands"

    def lines(self) -> Iterator[str]:
        """Yield the table."""
        from omniman_ros.lab import registry

        self.env.note_dependency(registry.__file__)
        yield from registry.markdown(self.arguments[0])


class Faults(Table):
    """The table of faults."""

    def lines(self) -> Iterator[str]:
        """Yield a table for each kind of thing that fails."""
        with mock(self.config.autodoc_mock_imports):
            from omniman_ros.lab.faults import page, table

            self.env.note_dependency(table.__file__)
            yield from page.markdown()


class ListeningSockets(Table):
    """The table of sockets on which the processes of the robot listen."""

    def lines(self) -> Iterator[str]:
        """Yield the table."""
        with mock(self.config.autodoc_mock_imports):
            from omniman_ros.nodes import listening_sockets

            self.env.note_dependency(listening_sockets.__file__)
            yield from listening_sockets.markdown()


class Figures(Table):
    """The table of a file of results, with its conditions and its command."""

    def lines(self) -> Iterator[str]:
        """Yield conditions, command and table."""
        path = Path(self.env.srcdir, "results", f"{self.arguments[0]}.json")
        self.env.note_dependency(str(path))
        yield from markdown_of(json.loads(path.read_text(encoding="utf-8")))


def markdown_of(result: dict[str, Any]) -> Iterator[str]:
    """Yield the Markdown of a result.

    Args:
        result: `columns` (texts) and `rows` (lists of texts, one per column); optionally
            `conditions` and `command`, which precede the table; `tag` if the command is gone.
    """
    if "conditions" in result:
        yield result["conditions"]
    if "command" in result:
        tag = result.get("tag")
        how = f"Measured at tag `{tag}`:" if tag else "Repeat with"
        yield f"{how} `{result['command']}`."
    yield ""
    columns = result["columns"]
    yield f"| {' | '.join(columns)} |"
    yield "|" + "---|" * len(columns)
    for row in result["rows"]:
        if len(row) != len(columns):
            raise ValueError(f"row {row}: {len(row)} cells for {len(columns)} columns")
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"


def add_stand_ins(app: Sphinx, config: Config) -> None:
    """Have autodoc replace libraries that are not installed."""
    missing = [name for name in OPTIONAL if importlib.util.find_spec(name) is None]
    config.autodoc_mock_imports = sorted({*config.autodoc_mock_imports, *missing})


def copy_changelog(app: Sphinx) -> None:
    """Copy the changelog to the pages, or say where it is if the sources are elsewhere."""
    import omniman_ros

    source = Path(omniman_ros.__file__).resolve().parents[1] / "CHANGELOG.md"
    page = Path(app.srcdir, "changelog.md")
    if source.is_file():
        page.write_text(source.read_text(encoding="utf-8"), encoding="utf-8")
    else:
        page.write_text("# Changelog\n\nSee `CHANGELOG.md` in the repository.\n", encoding="utf-8")


def write_example_pages(app: Sphinx) -> None:
    """Write a page for each script in examples/: its docstring, picture, figures and code.

    The scripts run for this, as far as they or the package are newer than their pictures.
    """
    import omniman_ros

    package = Path(omniman_ros.__file__).resolve().parent
    source, folder = package.parent / "examples", Path(app.srcdir, "examples")
    folder.mkdir(exist_ok=True)
    scripts = sorted(source.glob("[0-9]*.py"))
    for stale in folder.glob("[0-9]*"):
        if stale.stem not in [script.stem for script in scripts]:
            stale.unlink()
    readme = source / "README.md"
    index = readme.read_text(encoding="utf-8") if scripts else "# Examples\n\nSee `examples/`.\n"
    pages = "\n".join(script.stem for script in scripts)
    index = re.sub(r"\((\w+)\.py\)", r"(\1.md)", index)
    index = re.sub(r"\[(\w+)\]\(\w+\.ipynb\)", r"\1", index)
    _write(folder / "index.md", f"{index}\n```{{toctree}}\n:hidden:\n\n{pages}\n```\n")
    changed = max(path.stat().st_mtime for path in (*package.rglob("*.py"), *source.glob("*.py")))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for script, error in zip(
            scripts, pool.map(lambda script: _run(script, folder, changed), scripts), strict=True
        ):
            if error:
                logging.getLogger(__name__).warning("%s: %s", script.name, error)
            _write(folder / f"{script.stem}.md", "\n".join(_example_page(script, folder)))


def _run(script: Path, folder: Path, changed: float) -> str:
    """Have a script write its picture and its figures, unless they are new; return its error."""
    picture, figures = folder / f"{script.stem}.png", folder / f"{script.stem}.txt"
    if not picture.is_file() or picture.stat().st_mtime < changed:
        result = subprocess.run(
            [sys.executable, script, "--no-show", "--output", folder],
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "PYTHONPATH": str(script.parent.parent)},
        )
        lines = result.stdout.splitlines()
        figures.write_text("\n".join(line for line in lines if " = " in line), encoding="utf-8")
        return result.stderr if result.returncode else ""
    return ""


def _example_page(script: Path, folder: Path) -> Iterator[str]:
    code = script.read_text(encoding="utf-8")
    title, _, text = (ast.get_docstring(ast.parse(code)) or "").partition("\n")
    yield from (f"# {title.rstrip('.')}", text, "")
    if (folder / f"{script.stem}.png").is_file():
        yield from (f"![{title}]({script.stem}.png)", "")
    figures = (folder / f"{script.stem}.txt").read_text(encoding="utf-8")
    yield from ("```text", f"$ .venv/bin/python examples/{script.name}", figures, "```", "")
    yield from (f"`examples/{script.name}`:", "", "```python")
    yield from (code.partition('"""\n\n')[2], "```", "")


def _write(path: Path, text: str) -> None:
    """Write a page if its text has changed, so that Sphinx does not read it again in vain."""
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


SECTION = re.compile(r"(Args|Arguments|Attributes|Example|Examples|Note|Raises|Returns|Yields):$")
ARRAY = re.compile(
    r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], "
    r"~?(?:numpy\.)?dtype\[~?(?:numpy\.)?float64\]\]"
)
LIST_ITEM = re.compile(r"([*+-]|#\.|\(?[\w]{1,2}[.)])\s+\S")


def make_docstrings_safe(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Rewrite a docstring whose plain text reStructuredText would take for markup.

    Indented text that belongs to no list and no section becomes a literal block: equations and
    small tables are written like that. Bars and asterisks are escaped, and so are underscores at
    the ends of words.
    """
    end = next((k for k, line in enumerate(lines) if SECTION.match(line)), len(lines))
    safe: list[str] = []
    literal = in_list = False
    for k, line in enumerate(lines):
        if k < end and line.strip():
            indented = line.startswith("  ")
            if not indented:
                in_list = bool(LIST_ITEM.match(line)) and _stands_alone(lines, k)
            if indented and not in_list and not literal:
                safe += ["", "::", ""]
            elif literal and not indented:
                safe.append("")
            literal = indented and not in_list
            if not literal and not in_list and LIST_ITEM.match(line):
                line = "\\" + line
        elif k >= end:
            literal = False
        safe.append(line if literal or (k < end and not line.strip()) else _escaped(line))
    lines[:] = safe


_plain: dict[str, list[str]] = {}


def keep_plain_docstring(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Remember the docstring of a constant, whose first colon napoleon would take for a type."""
    if what in ("data", "attribute", "property") and not any(map(SECTION.match, lines)):
        _plain[name] = list(lines)


def restore_plain_docstring(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Restore what :func:`keep_plain_docstring` remembered."""
    lines[:] = _plain.pop(name, lines)


def shorten_signature(
    app: Sphinx,
    what: str,
    name: str,
    obj: object,
    options: object,
    signature: str | None,
    returns: str | None,
) -> tuple[str | None, str | None]:
    """Write the package's type of arrays by its name."""
    return (
        signature and ARRAY.sub("Array", signature),
        returns and ARRAY.sub("Array", returns),
    )


def _stands_alone(lines: list[str], k: int) -> bool:
    """Return whether a line that looks like a list item is one, and not a wrapped sentence."""
    before = lines[k - 1] if k else ""
    after = lines[k + 1] if k + 1 < len(lines) else ""
    starts = not before.strip() or before.startswith("  ") or bool(LIST_ITEM.match(before))
    return starts and (not after.strip() or after.startswith("  ") or bool(LIST_ITEM.match(after)))


def _escaped(line: str) -> str:
    parts = re.split(r"(``.*?``|:\w+:`.*?`|`[^`]*`)", line)
    parts[::2] = [
        re.sub(r"(?<=\w)_(?=\W|$)", r"\\_", re.sub(r"(?<!^)([|*])", r"\\\1", part))
        for part in parts[::2]
    ]
    return "".join(parts)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directives and the writers of pages."""
    app.add_directive("parameters", Parameters)
    app.add_directive("robot-parameters", RobotParameters)
    app.add_directive("lab", Lab)
    app.add_directive("faults", Faults)
    app.add_directive("listening-sockets", ListeningSockets)
    app.add_directive("figures", Figures)
    app.connect("config-inited", add_stand_ins)
    app.connect("builder-inited", write_example_pages)
    app.connect("builder-inited", copy_changelog)
    # Before napoleon, which makes markup of its own.
    app.connect("autodoc-process-docstring", make_docstrings_safe, priority=100)
    app.connect("autodoc-process-docstring", keep_plain_docstring, priority=200)
    app.connect("autodoc-process-docstring", restore_plain_docstring, priority=900)
    app.connect("autodoc-process-signature", shorten_signature)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
