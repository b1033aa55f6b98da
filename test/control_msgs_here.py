"""control_msgs for tests: the installed one, or what `follow_joint_trajectory` needs of it.

It is not on PyPI. Where the generators of ROS interfaces and a compiler are, the package is built
from the definitions below, once for all runs; it is seen only by tests that ask for it.
"""

import contextlib
import hashlib
import importlib
import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

PACKAGE = "control_msgs"
DEFINITIONS = {
    "msg/JointTolerance.msg": """
string name
float64 position
float64 velocity
float64 acceleration
float64 effort
""",
    "msg/JointComponentTolerance.msg": """
uint16 X_AXIS=1
uint16 Y_AXIS=2
uint16 Z_AXIS=3
uint16 TRANSLATION=4
uint16 ROTATION=5
string joint_name
uint16 component
float64 position
float64 velocity
float64 acceleration
""",
    "action/FollowJointTrajectory.action": """
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
JointTolerance[] path_tolerance
JointComponentTolerance[] component_path_tolerance
JointTolerance[] goal_tolerance
JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
int32 error_code
int32 SUCCESSFUL = 0
int32 INVALID_GOAL = -1
int32 INVALID_JOINTS = -2
int32 OLD_HEADER_TIMESTAMP = -3
int32 PATH_TOLERANCE_VIOLATED = -4
int32 GOAL_TOLERANCE_VIOLATED = -5
string error_string
---
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
""",
}
"""Fields in their order and constants: what clients and servers must agree on."""

KINDS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
"""Type supports, each a library of its own that is found by its name."""
DEPENDENCIES = (
    "action_msgs",
    "builtin_interfaces",
    "geometry_msgs",
    "service_msgs",
    "std_msgs",
    "trajectory_msgs",
    "unique_identifier_msgs",
)
LIBRARIES = (
    "rosidl_runtime_c",
    "rosidl_typesupport_c",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp",
    "rosidl_typesupport_introspection_c",
    "rcutils",
    "fastcdr",
    "rmw",
)
BUILD_TIMEOUT = 300.0
LOADER = """import ctypes
import pathlib

for library in sorted(pathlib.Path(__file__).parent.glob("lib*.so")):
    ctypes.CDLL(str(library))
"""
"""The package's __init__: libraries that are loaded need not be looked for."""

_modules: dict[str, ModuleType] = {}


def folder() -> Path | None:
    """Folder to put on PYTHONPATH; None where control_msgs is installed. Skips without a way."""
    if not _modules and importlib.util.find_spec(PACKAGE) is not None:
        return None
    headers = Path(sysconfig.get_paths()["include"], "Python.h")
    missing = [tool for tool in ("gcc", "g++") if shutil.which(tool) is None]
    missing += [] if headers.exists() else ["Python.h"]
    modules = ("rosidl_adapter", "rosidl_generator_py", "rosidl_typesupport_fastrtps_c", "rclpy")
    missing += [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        pytest.skip(f"no {PACKAGE}, and it cannot be built without {', '.join(missing)}")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "omniman_ros")
    made = (sys.version, str(_prefix()), version("rclpy"), Path(__file__).read_text())
    target = cache / f"{PACKAGE}-{hashlib.sha256(repr(made).encode()).hexdigest()[:16]}"
    if not target.exists():
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cache) as work:
            command = [sys.executable, __file__, work]
            env = {**os.environ, "AMENT_PREFIX_PATH": str(_prefix())}
            subprocess.run(
                command, env=env, check=True, timeout=BUILD_TIMEOUT, stdout=subprocess.DEVNULL
            )
            with contextlib.suppress(OSError):  # another process was faster
                Path(work, "python").rename(target)
    return target


@contextlib.contextmanager
def installed() -> Iterator[Any]:
    """control_msgs can be imported within, and not after; gives FollowJointTrajectory."""
    place = folder()
    if place is not None:
        sys.path.insert(0, str(place))
        sys.modules.update(_modules)
        importlib.invalidate_caches()
    try:
        yield importlib.import_module(f"{PACKAGE}.action").FollowJointTrajectory
    finally:
        if place is not None:
            sys.path.remove(str(place))
            for name in [n for n in sys.modules if n.split(".")[0] == PACKAGE]:
                _modules[name] = sys.modules.pop(name)


def _prefix() -> Path:
    """Where ROS is installed: PREFIX/lib/pythonX.Y/site-packages/trajectory_msgs/__init__.py."""
    spec = importlib.util.find_spec("trajectory_msgs")
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).parents[4]


# ---- build: a process of its own, as the generators print and want an environment --------------


def _generate(work: Path) -> None:
    from rosidl_adapter.cli import TranslateActionToIDL, TranslateMsgToIDL
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    idl, out = [], work / "code" / PACKAGE
    for name, text in DEFINITIONS.items():
        file = work / "definitions" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        translate = TranslateMsgToIDL if name.startswith("msg") else TranslateActionToIDL
        idl += translate("").translate(PACKAGE, [f"{file.parents[1]}:{name}"], [], work / "idl")
        (out / name).parent.mkdir(parents=True, exist_ok=True)
    known = (PACKAGE, idl, [str(_prefix() / "share")])
    hashes = HashTypeDescription("").generate_type_hashes(*known, out)
    GenerateC("").generate(*known, out, hashes)
    GenerateFastRTPSCTypesupport("").generate(*known, work / KINDS[0] / PACKAGE)
    GenerateIntrospectionCTypesupport("").generate(*known, work / KINDS[1] / PACKAGE)
    dispatch = GenerateCTypesupport("", typesupport_implementations=list(KINDS))
    dispatch.generate(*known, work / "dispatch" / PACKAGE)
    python = GeneratePython("", typesupport_implementations=["rosidl_typesupport_c"])
    python.generate(*known, work / "python" / PACKAGE)


def _compile(work: Path) -> None:
    import numpy as np

    prefix, target = _prefix(), work / "python" / PACKAGE
    nested = [d for d in (prefix / "include").iterdir() if (d / d.name).is_dir()]
    parts = [work / part for part in ("code", *KINDS, "dispatch", "python")]
    includes = [
        *parts,
        sysconfig.get_paths()["include"],
        np.get_include(),
        prefix / "include",
        *nested,
    ]
    kinds = ("rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_c", *KINDS)
    names = [*LIBRARIES, *(f"{package}__{kind}" for package in DEPENDENCIES for kind in kinds)]
    others = [prefix / "lib" / f"lib{name}.so" for name in names]
    flags = [f"-I{place}" for place in includes]
    common = ["gcc", "-shared", "-O0", "-fPIC", "-w", *flags]
    end = ["-lstdc++", f"-Wl,-rpath,{prefix / 'lib'}", "-Wl,-rpath,$ORIGIN"]
    extension = f"{PACKAGE}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
    libraries = [f"lib{PACKAGE}__{kind}.so" for kind in ("rosidl_generator_c", *KINDS)]
    sources = [parts[:1], parts[1:2], parts[2:3], parts[3:]]
    built: list[Path] = []
    for library, places in zip([*libraries, extension], sources, strict=True):
        files = [f for p in places for f in p.rglob("*") if f.suffix in (".c", ".cpp")]
        name = ["-o", target / library, f"-Wl,-soname,{library}"]
        subprocess.run([*common, *name, *files, *built, *others, *end], check=True)
        built.append(target / library)
    (target / "__init__.py").write_text(LOADER)


if __name__ == "__main__":
    _generate(Path(sys.argv[1]))
    _compile(Path(sys.argv[1]))
