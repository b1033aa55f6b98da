"""Packages of ROS interfaces for tests: the installed ones, or what the tests need of them.

They are not on PyPI. Where the generators of ROS interfaces and a compiler are, a package is built
from the definitions in `interfaces`, once for all runs; it is seen only by tests that ask for it.
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

import pytest

#: Folder with a folder for each package: fields in their order and constants, which are what
#: publishers and subscribers, clients and servers must agree on.
DEFINITIONS = Path(__file__).with_name("interfaces")
#: Type supports, each a library of its own that is found by its name
KINDS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
DEPENDENCIES = (
    "action_msgs",
    "builtin_interfaces",
    "geometry_msgs",
    "nav_msgs",
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
"""  #: The package's __init__: libraries that are loaded need not be looked for

#: Modules of each package that was imported, by their names
_modules: dict[str, dict[str, ModuleType]] = {}


def folder(package: str) -> Path | None:
    """Folder to put on PYTHONPATH; None where the package is installed. Skips without a way."""
    if package not in _modules and importlib.util.find_spec(package) is not None:
        return None
    headers = Path(sysconfig.get_paths()["include"], "Python.h")
    missing = [tool for tool in ("gcc", "g++") if shutil.which(tool) is None]
    missing += [] if headers.exists() else ["Python.h"]
    modules = ("rosidl_adapter", "rosidl_generator_py", "rosidl_typesupport_fastrtps_c", "rclpy")
    missing += [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        pytest.skip(f"no {package}, and it cannot be built without {', '.join(missing)}")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "omniman_ros")
    texts = [file.read_text() for file in _definitions(package)]
    made = (sys.version, str(_prefix()), version("rclpy"), Path(__file__).read_text(), texts)
    target = cache / f"{package}-{hashlib.sha256(repr(made).encode()).hexdigest()[:16]}"
    if not target.exists():
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cache) as work:
            command = [sys.executable, __file__, package, work]
            env = {**os.environ, "AMENT_PREFIX_PATH": str(_prefix())}
            subprocess.run(
                command, env=env, check=True, timeout=BUILD_TIMEOUT, stdout=subprocess.DEVNULL
            )
            with contextlib.suppress(OSError):  # another process was faster
                Path(work, "python").rename(target)
    return target


@contextlib.contextmanager
def installed(package: str) -> Iterator[None]:
    """Make a package importable within the context, and not after it."""
    place = folder(package)
    if place is not None:
        sys.path.insert(0, str(place))
        sys.modules.update(_modules.get(package, {}))
        importlib.invalidate_caches()
    try:
        importlib.import_module(package)
        yield
    finally:
        if place is not None:
            sys.path.remove(str(place))
            _modules[package] = {
                name: sys.modules.pop(name)
                for name in [n for n in sys.modules if n.split(".")[0] == package]
            }


def _definitions(package: str) -> list[Path]:
    """Definitions of a package; messages come first, since actions are made of them."""
    found = [file for file in (DEFINITIONS / package).rglob("*.*") if file.is_file()]
    return sorted(found, key=lambda file: (file.suffix != ".msg", file.name))


def _prefix() -> Path:
    """Where ROS is installed: PREFIX/lib/pythonX.Y/site-packages/trajectory_msgs/__init__.py."""
    spec = importlib.util.find_spec("trajectory_msgs")
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).parents[4]


def _generate(package: str, work: Path) -> None:
    from rosidl_adapter.cli import TranslateActionToIDL, TranslateMsgToIDL
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    idl, out = [], work / "code" / package
    for file in _definitions(package):
        name = file.relative_to(DEFINITIONS / package)
        translate = TranslateMsgToIDL if file.suffix == ".msg" else TranslateActionToIDL
        idl += translate("").translate(package, [f"{file.parents[1]}:{name}"], [], work / "idl")
        (out / name).parent.mkdir(parents=True, exist_ok=True)
    known = (package, idl, [str(_prefix() / "share")])
    hashes = HashTypeDescription("").generate_type_hashes(*known, out)
    GenerateC("").generate(*known, out, hashes)
    GenerateFastRTPSCTypesupport("").generate(*known, work / KINDS[0] / package)
    GenerateIntrospectionCTypesupport("").generate(*known, work / KINDS[1] / package)
    dispatch = GenerateCTypesupport("", typesupport_implementations=list(KINDS))
    dispatch.generate(*known, work / "dispatch" / package)
    python = GeneratePython("", typesupport_implementations=["rosidl_typesupport_c"])
    python.generate(*known, work / "python" / package)


def _compile(package: str, work: Path) -> None:
    import numpy as np

    prefix, target = _prefix(), work / "python" / package
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
    extension = f"{package}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
    libraries = [f"lib{package}__{kind}.so" for kind in ("rosidl_generator_c", *KINDS)]
    sources = [parts[:1], parts[1:2], parts[2:3], parts[3:]]
    built: list[Path] = []
    for library, places in zip([*libraries, extension], sources, strict=True):
        files = [f for p in places for f in p.rglob("*") if f.suffix in (".c", ".cpp")]
        name = ["-o", target / library, f"-Wl,-soname,{library}"]
        subprocess.run([*common, *name, *files, *built, *others, *end], check=True)
        built.append(target / library)
    (target / "__init__.py").write_text(LOADER)


if __name__ == "__main__":
    _generate(sys.argv[1], Path(sys.argv[2]))
    _compile(sys.argv[1], Path(sys.argv[2]))
