"""Definitions of message types, which a recording contains.

The types of ROS 2 Jazzy are known. Others are read from the packages that define them, from
`share/PACKAGE/msg/NAME.msg` below one of the prefixes.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from omniman_ros.core.errors import InputError

BUILT_IN_TYPES = {
    "bool",
    "byte",
    "char",
    "float32",
    "float64",
    "int8",
    "uint8",
    "int16",
    "uint16",
    "int32",
    "uint32",
    "int64",
    "uint64",
    "string",
    "wstring",
}  #: Types of fields that need no definition
#: Name of a message type: package and name
TYPE_PATTERN = re.compile(r"^([A-Za-z]\w*)/msg/([A-Za-z]\w*)$")
#: Field of a definition, whose first group is its type; bounds and lengths are skipped
FIELD_PATTERN = re.compile(r"^([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*")


class MessageDefinitions:
    """Finds the definitions of message types below prefixes; the first that has one counts."""

    def __init__(self, prefixes: Sequence[Path] = ()) -> None:
        self._prefixes = tuple(prefixes)
        self._store = get_typestore(Stores.ROS2_JAZZY)

    def lookup(self, message_type: str) -> tuple[str, str]:
        """Return the definition and the hash of a message type, PACKAGE/msg/NAME.

        Returns:
            The definition, followed by those of the types in it, in MCAP's format `ros2msg`; and
            the hash of REP 2011, RIHS01_...

        Raises:
            InputError: The name is not that of a message type, or the type is neither known nor
                installed.
        """
        if not TYPE_PATTERN.match(message_type):
            raise InputError(f"'{message_type}' is not a message type, expected PACKAGE/msg/NAME")
        if message_type not in self._store.fielddefs:
            self._load(message_type)
        text, _ = self._store.generate_msgdef(message_type, ros_version=2)
        return text, self._store.hash_rihs01(message_type)

    def _load(self, message_type: str) -> None:
        definitions, pending = {}, [message_type]
        while pending:
            name = pending.pop()
            if name in definitions or name in self._store.fielddefs:
                continue
            text = self._read(name)
            definitions.update(get_types_from_msg(text, name))
            pending += _field_types(text, name.partition("/")[0])
        self._store.register(definitions)

    def _read(self, message_type: str) -> str:
        package, _, name = message_type.split("/")
        for prefix in self._prefixes:
            file = prefix / "share" / package / "msg" / f"{name}.msg"
            if file.is_file():
                # Comments may be in any encoding.
                return file.read_text(encoding="utf-8-sig", errors="replace")
        raise InputError(
            f"{message_type} is not installed here: no share/{package}/msg/{name}.msg"
        )


def _field_types(text: str, package: str) -> list[str]:
    """Return the message types of a definition's fields; those without a package are its own."""
    types = []
    for line in text.splitlines():
        field = FIELD_PATTERN.match(line.split("#")[0].strip())
        if field is None or field[1].partition("<")[0] in BUILT_IN_TYPES:
            continue
        parts = field[1].split("/")
        owner = parts[0] if len(parts) > 1 else package
        types.append(f"{'std_msgs' if parts == ['Header'] else owner}/msg/{parts[-1]}")
    return types
