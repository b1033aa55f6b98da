"""YAML files, read as ROS reads its parameter files.

A robot's file may be given to a node as a parameter file as well, and the same text must then mean
the same. The reference is the reader of rcl 9.2 (Jazzy): `12e-3` is a number and `1_000` a text,
though YAML 1.1, which PyYAML follows, has it the other way round.
"""

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import yaml

from omniman_ros.core.errors import FileError
from omniman_ros.core.parameters import flatten_mapping

FOR_ALL_NODES = "/**"  #: Pattern of the names of all nodes
#: Key below which a section of a ROS parameter file has its parameters
PARAMETERS = "ros__parameters"
_TRUE = {"y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"}
_FALSE = {"n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"}
_INTEGER = re.compile(r"([+-]?)(?:0[xX]([0-9a-fA-F]+)|(0[0-7]*)|([1-9][0-9]*))")
_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_HEXADECIMAL = re.compile(
    r"[+-]?0[xX](?:[0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)(?:[pP][+-]?[0-9]+)?"
)
_NOT_FINITE = re.compile(r"\.(?:nan|NaN|NAN)|[+-]?\.(?:inf|Inf|INF)|(?i:[+-]?(?:nan|inf(inity)?))")
_TEXT_TAG = "tag:yaml.org,2002:str"
#: Names of the types of values, for messages
_KINDS = {bool: "a boolean", int: "an integer", float: "a double", str: "a text"}
#: Loader of libyaml, where PyYAML has it: nine times faster, and every node reads a robot
_BASE: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Loader(_BASE):  # type: ignore[misc]  # the base depends on how PyYAML was built
    """Leaves the types of scalars to :func:`scalar`."""

    DEFAULT_SCALAR_TAG = "!untagged"
    yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {}


@dataclass(frozen=True)
class Section:
    """Parameters in a ROS parameter file."""

    nodes: str  #: Pattern of the absolute names of the nodes that they are for
    line: int  #: Line at which the section begins
    values: Mapping[str, Any]  #: Full parameter names to values

    def is_for(self, node: str) -> bool:
        """Return whether a node with this absolute name gets the parameters."""
        return re.fullmatch(self.nodes.replace("/*", r"(/\w+)"), node) is not None


def scalar(text: str) -> bool | int | float | str:
    """Return the value of a scalar without quotes: C's `strtol` and `strtod` decide.

    A leading 0 makes an integer octal, 0x hexadecimal. A number beyond the range of its type is
    the next type: an integer a double, a double a text.
    """
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if _NOT_FINITE.fullmatch(text):
        return float(text.replace(".", ""))
    integer = _integer(text)
    return _double(text) if integer is None else integer


def _integer(text: str) -> int | None:
    """Return a text as a 64-bit integer, or None if it is none."""
    match = _INTEGER.fullmatch(text)
    if match is None:
        return None
    sign, hexadecimal, octal, decimal = match.groups()
    digits, base = next((d, b) for d, b in ((hexadecimal, 16), (octal, 8), (decimal, 10)) if d)
    value = int(sign + digits, base)
    return value if -(2**63) <= value < 2**63 else None


def _double(text: str) -> float | str:
    """Return a text as a double, or the text if it is none or out of range."""
    try:
        if _DECIMAL.fullmatch(text):
            mantissa, value = re.split("[eE]", text)[0], float(text)
        elif _HEXADECIMAL.fullmatch(text):
            mantissa, value = re.split("[xXpP]", text)[1], float.fromhex(text)
        else:
            return text
    except OverflowError:
        return text
    in_range = sys.float_info.min <= abs(value) <= sys.float_info.max
    return value if in_range or not mantissa.strip("+-0.") else text


def read_yaml(path: Path) -> Any:
    """Return the content of a file with one document; None if it is empty.

    Raises:
        FileError: The file cannot be read, is not YAML, or has a key twice.
    """
    documents = _documents(_read_bytes(path), str(path))
    return _value(documents[0], str(path)) if documents else None


def parse_value(text: str) -> Any:
    """Return the value of a parameter on a command line, NAME:=VALUE.

    Raises:
        FileError: The text is not YAML.
    """
    documents = _documents(text.encode(), "value")
    return _value(documents[0], "value") if documents else None


def read_parameters(path: Path) -> Sequence[Section]:
    """Return the sections of a ROS parameter file, those that go first last.

    Raises:
        FileError: The file cannot be read, or ROS does not take it.
    """
    return _sections(_read_bytes(path), str(path))


@lru_cache(maxsize=8)
def _sections(data: bytes, source: str) -> tuple[Section, ...]:
    """Return the sections in the content of a file."""
    return tuple(
        section
        for document in _documents(data, source)
        for section in _sections_below(document, "", source, set())
    )


def _sections_below(node: yaml.Node, name: str, source: str, seen: set[int]) -> Iterator[Section]:
    """Yield the sections below a part of the name of nodes."""
    if not isinstance(node, yaml.MappingNode):
        raise _error(source, node, f"has no '{FOR_ALL_NODES}: {PARAMETERS}:' with values")
    for key, value in node.value:
        if _key(key, source) != PARAMETERS:
            below = f"{name}/{_key(key, source).strip('/')}"
            yield from _sections_below(value, below, source, seen)
        elif not name or not isinstance(value, yaml.MappingNode):
            raise _error(source, key, f"has no '{FOR_ALL_NODES}: {PARAMETERS}:' with values")
        else:
            values = flatten_mapping(dict(_parameters(value, "", source, seen)))
            yield Section(name, node.start_mark.line + 1, values)


def _parameters(
    node: yaml.MappingNode, prefix: str, source: str, seen: set[int]
) -> Iterator[tuple[str, Any]]:
    """Yield the full names and the values of the parameters in a mapping."""
    for key, value in node.value:
        name = prefix + _key(key, source)
        items = value.value if isinstance(value, yaml.SequenceNode) else [value]
        for entry in {id(entry): entry for entry in (value, *items)}.values():
            if id(entry) in seen:
                raise _error(source, key, f"'{name}' is an alias, which ROS does not know")
            seen.add(id(entry))
        if isinstance(value, yaml.MappingNode):
            yield from _parameters(value, f"{name}.", source, seen)
            continue
        if not all(isinstance(item, yaml.ScalarNode) for item in items):
            raise _error(source, value, f"'{name}' is not an array of plain values")
        found = _value(value, source)
        values = found if isinstance(found, list) else [found]
        if None in values:
            raise _error(source, value, f"'{name}' has no value")
        for first, second in pairwise(values):
            if type(first) is not type(second):
                raise _error(
                    source,
                    value,
                    f"'{name}' mixes types, which ROS refuses: {first!r} is "
                    f"{_KINDS[type(first)]}, {second!r} {_KINDS[type(second)]}",
                )
        yield name, found


def _value(node: yaml.Node, source: str, around: frozenset[int] = frozenset()) -> Any:
    """Return the value of a node, which is inside of others."""
    if isinstance(node, yaml.ScalarNode):
        if node.tag == _TEXT_TAG or node.style in ("'", '"'):
            return node.value
        return scalar(node.value) if node.value else None
    if id(node) in around:
        raise _error(source, node, "contains itself")
    around |= {id(node)}
    if isinstance(node, yaml.SequenceNode):
        return [_value(item, source, around) for item in node.value]
    tree: dict[str, Any] = {}
    for key, value in node.value:
        name = _key(key, source)
        if name in tree:
            raise _error(source, key, f"'{name}' is given twice")
        tree[name] = _value(value, source, around)
    return tree


def _key(node: yaml.Node, source: str) -> str:
    """Return a key, which is a text even where it looks like a number."""
    if not isinstance(node, yaml.ScalarNode):
        raise _error(source, node, "a key must be a name")
    return str(node.value)


def _read_bytes(path: Path) -> bytes:
    """Return the content of a file."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError(str(path), None, error.strerror or str(error)) from error


def _documents(data: bytes, source: str) -> list[yaml.Node]:
    """Return the documents of a file; the byte order mark or its absence tells the encoding."""
    try:
        return list(yaml.compose_all(data, Loader=_Loader))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark is not None else None
        reason = ", ".join(filter(None, (error.problem, error.context)))
        lines = data.splitlines()
        indent = re.match(rb"\s*", lines[line - 1]) if line and line <= len(lines) else None
        if indent and b"\t" in indent[0]:
            reason += "; YAML is indented by spaces, not by tabs"
        raise FileError(source, line, reason) from error
    except yaml.reader.ReaderError as error:
        before = data[: error.position]
        reason = f"is neither UTF-8 nor UTF-16 text: {error.reason}"
        raise FileError(source, before.count(b"\n") + 1, reason) from error
    except RecursionError as error:
        raise FileError(source, None, "is nested too deeply") from error


def _error(source: str, node: yaml.Node, reason: str) -> FileError:
    return FileError(source, node.start_mark.line + 1, reason)
