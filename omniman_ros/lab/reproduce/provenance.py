"""Provenance of a result: versions of the software, commit and machine."""

import importlib.metadata
import platform
import subprocess
from pathlib import Path
from typing import Any

import omniman_ros
from omniman_ros.console.results import run_metadata

PACKAGES = ("omniman_ros", "numpy", "casadi")
"""Distributions whose versions are recorded."""


def versions() -> dict[str, str]:
    """Return the versions of Python, this package and its main libraries, by name.

    The commit is included if the package is in a git working tree.
    """
    result = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            result[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            result[name] = "not installed"
    if revision := commit(Path(omniman_ros.__file__)):
        result["commit"] = revision
    return result


def commit(file: Path) -> str:
    """Return the commit of the git working tree that tracks a file.

    Args:
        file: Path of the file.

    Returns:
        The short hash, followed by `+` if tracked files have been changed since; empty if the file
        is not tracked or git is not available.
    """

    def git(*arguments: str) -> str | None:
        try:
            completed = subprocess.run(
                ["git", "-C", str(file.parent), *arguments],
                capture_output=True,
                text=True,
                timeout=10.0,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired):
            return None
        return completed.stdout.strip() if completed.returncode == 0 else None

    if git("ls-files", "--error-unmatch", file.name) is None:
        return ""
    head, changed = git("rev-parse", "--short=12", "HEAD"), git("status", "--porcelain", "-uno")
    return f"{head}{'+' if changed else ''}" if head else ""


def machine() -> dict[str, Any]:
    """Return the processor, the number of cores and the operating system.

    Nothing that identifies the individual machine, such as its host name, is included.
    """
    model = platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    try:
        system = platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        system = platform.system()
    return {"processor": model, "cores": run_metadata()["cores"], "system": system}
