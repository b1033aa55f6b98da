"""What the layers' contract in pyproject.toml cannot say: what comes along at run time."""

import json
import subprocess
import sys

import pytest

LOADED = """
import importlib, json, pathlib, sys
import numpy
before = set(sys.modules)
import omniman_ros
root = pathlib.Path(omniman_ros.__file__).parent
for room in ("core", "control", "motion"):
    for path in (root / room).rglob("*.py"):
        importlib.import_module(".".join(path.relative_to(root.parent).with_suffix("").parts))
print(json.dumps(sorted(set(sys.modules) - before)))
"""


@pytest.fixture(scope="module")
def loaded():
    """Modules that the cores bring into a fresh interpreter that has numpy already."""
    run = [sys.executable, "-c", LOADED]
    result = subprocess.run(run, capture_output=True, text=True, check=True, timeout=60)
    return json.loads(result.stdout)


@pytest.mark.parametrize(
    "package",
    ["rclpy", "can", "casadi", "yaml", "socket", "asyncio", "multiprocessing", "geometry_msgs"],
)
def test_the_cores_bring_no_ros_bus_solver_or_socket_along(loaded, package):
    assert "omniman_ros.control.platform" in loaded
    assert not [name for name in loaded if name.split(".")[0] == package]


def test_no_node_needs_casadi_to_be_imported():
    """A machine without it can do all but plan: every node reads the names of all parameters."""
    code = (
        "import sys; sys.modules['casadi'] = None; import omniman_ros.nodes.registry as r; "
        "assert 'weights.position' in r.known_names()"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
