"""Definitions of message types, which a recording carries with it.

Those of ROS 2 Jazzy are known; others are read from the packages that have them, as
`share/PACKAGE/msg/NAME.msg` below one of the prefixes.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from omniman_ros.core.errors import InputError

BUILT_IN = {
    "bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16", "int32",
    "uint32", "int64", "uint64", "string", "wstring",
}  # fmt: skip
NAME = re.compile(r"^([A-Za-z]\w*)/msg/([A-Za-z]\w*)$")
FIELD = re.compile(r"^([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*")


class Definitions:
    """Definitions by type name.

    Args:
        prefixes: Folders in which packages are installed, the first that has one wins.
    """

    def __init__(self, prefixes: Sequence[Path] = ()) -> None:
        self._prefixes = tuple(prefixes)
        self._store = get_typestore(Stores.ROS2_JAZZY)

    def of(self, kind: str) -> tuple[str, str]:
        """Text and hash of a type, PACKAGE/msg/NAME.

        Returns:
            The definition with those of the types in it, as MCAP has it (ros2msg); and the hash
            of REP 2011, RIHS01_...

        Raises:
            InputError: Not a message type, or neither known nor installed.
        """
        if not NAME.match(kind):
            raise InputError(f"'{kind}' is no message type, PACKAGE/msg/NAME")
        if kind not in self._store.fielddefs:
            self._load(kind)
        text, _ = self._store.generate_msgdef(kind, ros_version=2)
        return text, self._store.hash_rihs01(kind)

    def _load(self, kind: str) -> None:
        """Read a type and all in it that is not known."""
        found, waiting = {}, [kind]
        while waiting:
            name = waiting.pop()
            if name in found or name in self._store.fielddefs:
                continue
            text = self._text(name)
            found.update(get_types_from_msg(text, name))
            waiting += _types_in(text, name.partition("/")[0])
        self._store.register(found)

    def _text(self, kind: str) -> str:
        package, _, name = kind.split("/")
        for prefix in self._prefixes:
            file = prefix / "share" / package / "msg" / f"{name}.msg"
            if file.is_file():
                return file.read_text(encoding="utf-8")
        raise InputError(f"no definition of {kind} here: no share/{package}/msg/{name}.msg")


def _types_in(text: str, package: str) -> list[str]:
    """Types of the fields of a definition, with their package."""
    types = []
    for line in text.splitlines():
        field = FIELD.match(line.split("#")[0].strip())
        if field is None or field[1].partition("<")[0] in BUILT_IN:
            continue
        parts = field[1].split("/")
        owner = parts[0] if len(parts) > 1 else package
        types.append(f"{'std_msgs' if parts == ['Header'] else owner}/msg/{parts[-1]}")
    return types
