import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

import omniman_ros

PACKAGE = Path(omniman_ros.__file__).parent
CORE = sorted((PACKAGE / "core").glob("**/*.py"))
DRIVE = sorted((PACKAGE / "drive").glob("**/*.py"))
PLANNING = sorted((PACKAGE / "planning").glob("**/*.py"))
WITH_CASADI = {"model", "transcription", "solver"}
CORE_MODULES = {"__future__", "abc", "collections", "dataclasses", "enum", "functools", "heapq",
                "math", "types", "typing", "numpy"}  # fmt: skip
FORBIDDEN_CALLS = {"open", "input", "print", "exec", "eval", "__import__"}


def imports(path):
    """Absolute names of the modules that a file imports, also within functions."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: relative import"
            if node.module == "omniman_ros":
                yield from (f"omniman_ros.{alias.name}" for alias in node.names)
            else:
                yield str(node.module)


def below(name, *packages):
    return any(name == package or name.startswith(f"{package}.") for package in packages)


def test_there_are_files_to_check():
    assert len(CORE) > 15
    assert len(DRIVE) > 5
    assert {path.stem for path in PLANNING} >= WITH_CASADI


@pytest.mark.parametrize("path", CORE, ids=lambda path: path.stem)
def test_core_imports_numpy_and_itself_only(path):
    for name in imports(path):
        if below(name, "omniman_ros"):
            assert below(name, "omniman_ros.core"), name
        else:
            assert name.split(".")[0] in CORE_MODULES, name


ARM = sorted((PACKAGE / "arm").glob("**/*.py"))
OUTSIDE = {
    "sockets": {"contextlib", "errno", "os", "socket", "struct"},
    "rtde_link": {"socket"},
    "program_link": {"fcntl", "socket", "struct", "termios"},
    "link": {"select", "socket"},
    "dashboard": {"socket", "time"},
    "channel": {"contextlib", "pickle", "select", "socket", "struct"},
    "loop": {"gc", "os", "signal", "socket", "sys", "time"},
    "process": {"socket", "subprocess", "sys", "threading"},
}
"""Modules of the arm that are not pure, and what they need for that."""


@pytest.mark.parametrize("path", ARM, ids=lambda path: path.stem)
def test_the_arms_protocols_import_core_and_themselves_only(path):
    for name in imports(path):
        if below(name, "omniman_ros"):
            assert below(name, "omniman_ros.core", "omniman_ros.arm"), name
        else:
            allowed = CORE_MODULES | OUTSIDE.get(path.stem, {"struct"})
            assert name.split(".")[0] in allowed, name


CAN_DRIVE = sorted((PACKAGE / "can_drive").glob("**/*.py"))
ON_THE_BUS = {"bus"}


@pytest.mark.parametrize("path", CAN_DRIVE, ids=lambda path: path.stem)
def test_the_bridges_protocols_and_policy_know_no_bus_no_clock_and_no_simulation(path):
    names = list(imports(path))
    for name in names:
        assert not below(name, "rclpy", "casadi", "yaml", "asyncio"), name
        if below(name, "omniman_ros"):
            assert below(name, "omniman_ros.core", "omniman_ros.can_drive"), name
    if path.stem not in ON_THE_BUS:
        assert not [name for name in names if below(name, "can", "time", "threading", "socket")]


@pytest.mark.parametrize("path", DRIVE, ids=lambda path: path.stem)
def test_drive_imports_core_and_itself_only(path):
    for name in imports(path):
        assert not below(name, "rclpy", "casadi", "yaml"), name
        if below(name, "omniman_ros"):
            assert below(name, "omniman_ros.core", "omniman_ros.drive"), name


@pytest.mark.parametrize("path", PLANNING, ids=lambda path: path.stem)
def test_planning_imports_core_and_itself_and_casadi_where_it_solves(path):
    """The plant is not among it: what plans knows nothing of what moves."""
    for name in imports(path):
        if below(name, "omniman_ros"):
            assert below(name, "omniman_ros.core", "omniman_ros.planning"), name
        elif name == "casadi":
            assert path.stem in WITH_CASADI
        else:
            assert name.split(".")[0] in CORE_MODULES or path.stem == "availability", name


def test_no_node_needs_casadi_to_be_imported():
    """A machine without it can do all but plan: every node reads the names of all parameters."""
    code = (
        "import sys; sys.modules['casadi'] = None; import omniman_ros.nodes.registry as r; "
        "assert 'weights.position' in r.known_names()"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_conversions_know_no_node_and_no_drive():
    for name in imports(PACKAGE / "conversions.py"):
        assert not below(name, "rclpy"), name
        if below(name, "omniman_ros"):
            assert below(name, "omniman_ros.core"), name


@pytest.mark.parametrize("path", [*CORE, *PLANNING], ids=lambda path: path.stem)
def test_core_opens_no_file_and_prints_nothing(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in FORBIDDEN_CALLS, f"line {node.lineno}"


PROBE = """
import json, sys
before = set(sys.modules)
import numpy
known = set(sys.modules)
import importlib, pathlib
import omniman_ros.core
for path in pathlib.Path(omniman_ros.core.__path__[0]).glob("*.py"):
    if path.stem != "__init__":
        importlib.import_module(f"omniman_ros.core.{path.stem}")
print(json.dumps(sorted(set(sys.modules) - known)))
"""


@pytest.fixture(scope="module")
def loaded():
    """Modules that core brings into a fresh interpreter that has numpy already."""
    result = subprocess.run(
        [sys.executable, "-c", PROBE], capture_output=True, text=True, check=True, timeout=60
    )
    return json.loads(result.stdout)


@pytest.mark.parametrize(
    "module",
    ["rclpy", "can", "casadi", "yaml", "socket", "asyncio", "multiprocessing", "geometry_msgs",
     "omniman_ros.nodes", "omniman_ros.drive", "omniman_ros.conversions", "omniman_ros.robots"],
)  # fmt: skip
def test_core_brings_no_ros_bus_solver_or_socket_along(loaded, module):
    assert "omniman_ros.core.platform" in loaded
    assert not [name for name in loaded if below(name, module)]


SIMULATED_UR = sorted((PACKAGE / "simulated_ur").glob("**/*.py"))
WITH_SOCKETS = ("network", "ports", "server")


@pytest.mark.parametrize("path", SIMULATED_UR, ids=lambda path: path.stem)
def test_the_simulated_controller_shares_nothing_with_its_client(path):
    for name in imports(path):
        if below(name, "omniman_ros"):
            assert below(name, "omniman_ros.core", "omniman_ros.simulated_ur"), name
        elif path.stem not in WITH_SOCKETS:
            assert name.split(".")[0] not in {"socket", "select", "threading", "time", "rclpy"}


DESCRIPTION = sorted((PACKAGE / "description").glob("**/*.py"))


@pytest.mark.parametrize("path", DESCRIPTION, ids=lambda path: path.stem)
def test_the_description_imports_core_itself_and_xml_only(path):
    for name in imports(path):
        if below(name, "omniman_ros"):
            assert below(name, "omniman_ros.core", "omniman_ros.description"), name
        else:
            assert name.split(".")[0] in CORE_MODULES | {"xml"}, name
