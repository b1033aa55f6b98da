"""Files of recorded measurements that can be fitted again: JSON with a format and its version."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from omniman_ros.console.errors import CommandError
from omniman_ros.console.files import write_atomically
from omniman_ros.core.errors import OmnimanError

Record = TypeVar("Record")  #: Type of a record


def save_record(path: Path, form: str, units: str, tree: Mapping[str, Any]) -> None:
    """Write a record completely, or not at all with an OSError, or a ValueError for NaN."""
    text = json.dumps({"format": form, "units": units, **tree}, allow_nan=False)
    write_atomically(path, text + "\n")


def load_record(
    path: Path, form: str, what: str, parse: Callable[[Mapping[str, Any]], Record]
) -> Record:
    """Read a record; without such a file, a CommandError is raised."""
    try:
        tree = json.loads(path.read_bytes())
        if tree["format"] != form:
            raise ValueError(f"its format is '{tree['format']}', expected '{form}'")
        return parse(tree)
    except json.JSONDecodeError as error:
        reason = f"line {error.lineno}: {error.msg}"
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        reason = f"line {line}: is neither UTF-8 nor UTF-16 text"
    except OSError as error:
        reason = error.strerror or str(error)
    except (KeyError, TypeError) as error:
        reason = f"it has not the values of one ({error})"
    except (ValueError, OmnimanError) as error:
        reason = str(error)
    raise CommandError(f"'{path}' contains no {what}: {reason}", 2)
