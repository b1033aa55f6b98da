"""The scripts in examples/: each runs as its user runs it, and its figures hold."""

import ast
import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from test.tiers import exhaustive

pytest.importorskip("matplotlib")

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("[0-9]*.py"))
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
LEAST_SPREAD = 20  #: Least standard deviation of the brightness of a picture that shows something

#: Bounds of the figures that each script prints
FIGURES = {
    "01_kinematics": {"constraint_rate": (0.0, 1e-12), "error": (0.0, 1e-12)},
    "02_reachable_twists": {"of_the_box": (0.1666, 0.1667), "of_the_ellipsoid": (0.318, 0.319)},
    "03_coupling_control": {"largest_off": (0.05, 0.15), "largest_on": (0.0, 0.02)},
    "04_mpc": {"arrival": (4.0, 15.0), "gap": (0.1, 1.0)},
    "05_world_and_scan": {"odometry_error": (1e-4, 0.05)},
    "06_arm_and_platform_in_step": {"duration": (3.0, 6.0), "largest_usage": (0.7, 0.9)},
    "07_tool_on_its_path": {"length": (3.4, 3.7), "duration": (10.0, 30.0), "error": (0.0, 1e-6)},
    "08_whole_body_around_a_post": {"arrival": (6, 18), "gap": (0.03, 0.5), "off": (0.0, 1e-6)},
    "09_client": {"gap": (0.4, 1.5), "end_x": (2.4, 2.6)},
    "10_odometry_of_a_bag": {"parted": (0.03, 0.15)},
    "11_drive_protocol": {"at_rest": (0.3, 0.6)},
    "12_canopen_master": {"fastest": (20.0, 21.0), "turns": (29.5, 30.3)},
    "13_tool_goal_behind_a_wall": {"length": (4.5, 6.5), "off": (0.0, 1e-6)},
    "14_joint_goal_through_a_door": {"off": (0.0, 1e-6), "arm_at_the_door": (0.0, 0.1)},
}


def named(path):
    return path.stem


def require_held(name, figures):
    """Require that the figures of an example are within their bounds."""
    assert set(figures) == set(FIGURES[name])
    for figure, (low, high) in FIGURES[name].items():
        assert low <= figures[figure] <= high, figure


def run(script, folder):
    """Return the figures that a script prints."""
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    result = subprocess.run(
        [sys.executable, script, "--no-show", "--output", folder],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env=environment | {"PYTHONPATH": str(EXAMPLES.parent)},
    )
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    return {
        name: float(value)
        for name, value in re.findall(r"^(\w+) = (\S+)$", result.stdout, re.MULTILINE)
    }


@pytest.mark.processes
@pytest.mark.parametrize(
    "script", [exhaustive(it) if "client" in it.name else it for it in SCRIPTS], ids=named
)
def test_an_example_runs_and_its_figures_hold(script, tmp_path):
    from matplotlib import image

    require_held(script.stem, run(script, tmp_path))
    picture = image.imread(tmp_path / f"{script.stem}.png")
    assert 255.0 * picture[..., :3].std() > LEAST_SPREAD


@pytest.mark.parametrize("script", SCRIPTS, ids=named)
def test_an_example_is_short_and_uses_the_front_door(script):
    text = script.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 50
    tree = ast.parse(text)
    imported = [
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    ]
    modules = [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert [name for name in [*imported, *modules] if "omniman" in name] == ["omniman_ros"]


def test_the_table_lists_each_example():
    table = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| \[(\w+\.py)\]\(\1\) \| ", table, re.MULTILINE) == [
        script.name for script in SCRIPTS
    ]


def test_the_notebooks_are_made_from_the_scripts():
    """`.ci/notebooks` makes them anew."""
    maker = runpy.run_path(str(EXAMPLES.parent / ".ci" / "notebooks"))
    assert [path.stem for path in NOTEBOOKS] == list(maker["NAMES"])
    for path in NOTEBOOKS:
        assert path.read_text(encoding="utf-8") == maker["notebook"](path.with_suffix(".py"))


@pytest.mark.exhaustive
@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_a_notebook_runs_cell_by_cell_and_its_figures_hold(path, monkeypatch):
    from matplotlib import pyplot

    pyplot.switch_backend("agg")
    monkeypatch.syspath_prepend(str(EXAMPLES))
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    *codes, last = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    *statements, shown = ast.parse(last).body
    variables = {}
    for code in (*codes, ast.Module(statements, [])):
        exec(compile(code, path, "exec"), variables)
    require_held(path.stem, eval(ast.unparse(shown), variables))
    pyplot.close("all")
