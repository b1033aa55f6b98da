"""Results of demo and benchmarks: a JSON file, and for benchmarks the same as the last line."""

import json
import math
import os
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from omniman_ros.console.files import write_atomically
from omniman_ros.console.terminal import say


def rounded(value: Any, digits: int = 4) -> Any:
    """Return a value with floats rounded to significant digits; non-finite ones become None."""
    if isinstance(value, Mapping):
        return {str(key): rounded(item, digits) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(item, digits) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    return value


def run_metadata() -> dict[str, Any]:
    """Return the time at which, and the machine on which, a result was produced."""
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
    }


def publish(name: str, result: Mapping[str, Any], folder: str | Path = "results") -> Path:
    """Write a result with :func:`save`, print it as the last line, and return the file's path.

    Floats are rounded to four significant digits. The folder is created if it does not exist.
    """
    path = save(name, result, folder)
    say(f"Written to {path}:")
    say(json.dumps(json.loads(path.read_bytes())))
    return path


def save(name: str, result: Mapping[str, Any], folder: str | Path = "results") -> Path:
    """Write a result atomically to FOLDER/NAME.json; arguments and errors of :func:`publish`."""
    tree = rounded({"name": name, **result, "about": run_metadata()})
    path = Path(folder) / f"{name}.json"
    write_atomically(path, json.dumps(tree, indent=2, allow_nan=False) + "\n")
    return path
