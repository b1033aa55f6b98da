"""Provenance of a result: versions, commit and machine."""

import importlib.metadata
import platform
import subprocess
from pathlib import Path
from typing import Any

import omniman_ros
from omniman_ros.console.results import run_metadata

LIBRARIES = ("omniman_ros", "numpy", "casadi")


def versions() -> dict[str, str]:
    """Return the versions of Python, package and libraries, and the commit if there is one."""
    result = {"python": platform.python_version()}
    for name in LIBRARIES:
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
        file: The file.

    Returns:
        The short hash, with `+` if the tree has changed since; empty if no tree tracks the file.
    """

    def git(*arguments: str) -> str | None:
        try:
            ended = subprocess.run(
                ["git", "-C", str(file.parent), *arguments],
                capture_output=True,
                text=True,
                timeout=10.0,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired):
            return None
        return ended.stdout.strip() if ended.returncode == 0 else None

    if git("ls-files", "--error-unmatch", file.name) is None:
        return ""
    head, changed = git("rev-parse", "--short=12", "HEAD"), git("status", "--porcelain", "-uno")
    return f"{head}{'+' if changed else ''}" if head else ""


def machine() -> dict[str, Any]:
    """Return processor, number of cores and system, and nothing that identifies the machine."""
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
