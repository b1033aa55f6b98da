"""Results of demo and benchmarks: a JSON file, and the same JSON as the last line printed."""

import json
import math
import os
import platform
import tempfile
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from omniman_ros.cli.terminal import say


def rounded(value: Any, digits: int = 4) -> Any:
    """The value with its floats at some significant digits; what is not finite becomes None."""
    if isinstance(value, Mapping):
        return {str(key): rounded(item, digits) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(item, digits) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    return value


def about() -> dict[str, Any]:
    """When and where a result was made."""
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
    }


def publish(name: str, result: Mapping[str, Any], folder: str | Path = "results") -> Path:
    """Write FOLDER/NAME.json whole or not at all, say so, and print it in one line, the last.

    Raises:
        OSError: The folder cannot be written.
    """
    text = json.dumps(rounded({"name": name, **result, "about": about()}), allow_nan=False)
    path = Path(folder) / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False) as file:
        file.write(json.dumps(json.loads(text), indent=2) + "\n")
    Path(file.name).chmod(0o644)
    os.replace(file.name, path)
    say(f"Written to {path}:")
    say(text)
    return path
