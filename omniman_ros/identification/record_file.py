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
    """Write a record completely or not at all.

    Args:
        units: Units of the numbers, in words.
        tree: Content, with finite numbers only.

    Raises:
        OSError: The file cannot be written.
        ValueError: A number is not finite.
    """
    text = json.dumps({"format": form, "units": units, **tree}, allow_nan=False)
    write_atomically(path, text + "\n")


def load_record(
    path: Path, form: str, what: str, parse: Callable[[Mapping[str, Any]], Record]
) -> Record:
    """Read a record.

    Args:
        what: Name of the content, for the error.
        parse: Makes the record from the content.

    Raises:
        CommandError: The file does not exist, or is not such a record.
    """
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
