"""What rcl 9.2 makes of a parameter file, by its node, is what the package's own reader makes."""

import math
from pathlib import Path

import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter

from omniman_ros.core.errors import FileError
from omniman_ros.nodes.rclpy_compat import RCLError, parameter_overrides
from omniman_ros.yaml_files import parse_value, read_parameters, read_yaml, scalar

SCALARS = {
    "12e-3": 0.012,
    "1e3": 1000.0,
    "1.5E3": 1500.0,
    ".5": 0.5,
    "-.5": -0.5,
    "5.": 5.0,
    "+1": 1,
    "-0": 0,
    "1_000": "1_000",
    "1_000.5": "1_000.5",
    "0x1F": 31,
    "-0x10": -16,
    "0x1p3": 8.0,
    "0x": "0x",
    "010": 8,
    "08": 8.0,
    "0o10": "0o10",
    "0b11": "0b11",
    "1:30": "1:30",
    "1,5": "1,5",
    "2020-01-01": "2020-01-01",
    "9223372036854775807": 2**63 - 1,
    "9223372036854775808": 2.0**63,
    "0xFFFFFFFFFFFFFFFFFF": float(2**72 - 1),
    "1e400": "1e400",
    "1e-400": "1e-400",
    "0e-400": 0.0,
    "yes": True,
    "Off": False,
    "on": True,
    "n": False,
    "Y": True,
    "TRUE": True,
    "t": "t",
    "tRUE": "tRUE",
    "~": "~",
    "null": "null",
    ".inf": math.inf,
    "-inf": -math.inf,
    "Infinity": math.inf,
    "'1'": "1",
    '"yes"': "yes",
    "!!str 1": "1",
    "!!float 1": 1,
    ">-\n      1": 1,
    "|\n      1\n": "1\n",
    "grün": "grün",
    "&anchor 2": 2,
    "[12e-3, 1e3]": [0.012, 1000.0],
    "[yes, no]": [True, False],
}  #: Values of parameters: text and meaning
TEXT = "/**:\n  ros__parameters:\n    a: {b: 1}\n    c: grün\n"  #: Content of a parameter file
HEAD = "/**:\n  ros__parameters:\n"  #: Beginning of a parameter file
TAKEN = {
    "": {},
    "# nothing": {},
    "/**:\n  ros__parameters: {}": {},
    HEAD + "    a: 1\n    a: 2": {"a": 2},
    HEAD + "    a: {x: 1}\n    b: 1\n    a: {y: 2}": {"a.x": 1, "b": 1, "a.y": 2},
    HEAD + "    a.b: 1": {"a.b": 1},
    HEAD + "    1: 1\n    yes: 2": {"1": 1, "yes": 2},
    HEAD + "    a:\t1\t# a tab": {"a": 1},
    HEAD + "    a: 1\n---\n" + HEAD + "    b: 1": {"a": 1, "b": 1},
    HEAD + "    a: 1\nreader:\n  ros__parameters: {a: 2}": {"a": 2},
    "reader:\n  ros__parameters: {a: 2}\n" + HEAD + "    a: 1": {"a": 1},
    "other:\n  ros__parameters: {a: 2}": {},
    "/ns/reader:\n  ros__parameters: {a: 2}": {},
    "/*:\n  ros__parameters: {a: 2}": {"a": 2},
}  #: Files that are taken, and what the node `reader` gets
REFUSED = {
    HEAD + "    a: [1, 2.5]": (3, "'a' mixes types, .*: 1 is an integer, 2.5 a double"),
    HEAD + "    a: [x, 1]": (3, "'x' is a text, 1 an integer"),
    HEAD + "    a: [[1], [2]]": (3, "'a' is not an array of plain values"),
    HEAD + "    b: 1\n    a:\n": (4, "'a' has no value"),
    HEAD + "    a: &x 1\n    b: *x": (4, "'b' is an alias"),
    HEAD + "\ta: 1": (3, "by spaces, not by tabs"),
    HEAD + "    a: [1\n": (4, "did not find expected ',' or ']'"),
    HEAD + "    a: 'x\n": (4, "unexpected end of stream"),
    HEAD + "    a: \x07": (3, "neither UTF-8 nor UTF-16"),
    HEAD + "    a 1": (2, "has no '/\\*\\*: ros__parameters:' with values"),
    "a: 1": (1, "has no '/\\*\\*: ros__parameters:' with values"),
    "/**:\n  ros__parameters:": (2, "has no '/\\*\\*: ros__parameters:' with values"),
    "- 1": (1, "has no '/\\*\\*: ros__parameters:' with values"),
}  #: Files that are refused: line and reason


def by_rcl(path: Path) -> dict[str, Parameter]:
    """Return the parameters that a node `reader` gets from a file."""
    context = rclpy.Context()
    try:
        rclpy.init(args=["--ros-args", "--params-file", str(path)], context=context)
        node = Node("reader", context=context, start_parameter_services=False)
        try:
            return {name: given.value for name, given in parameter_overrides(node).items()}
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


def by_us(path: Path) -> dict[str, object]:
    """Return the same by the package's own reader."""
    values: dict[str, object] = {}
    for section in read_parameters(path):
        values |= section.values if section.is_for("/reader") else {}
    return values


@pytest.mark.parametrize(("text", "value"), SCALARS.items())
def test_a_value_is_what_rcl_takes_it_for(text, value):
    found = parse_value(text)
    assert (type(found), found) == (type(value), value)


def test_rcl_takes_these_values_so(tmp_path):
    file = tmp_path / "values.yaml"
    lines = [f"    v{i}: {text}\n" for i, text in enumerate(SCALARS)]
    file.write_text(HEAD + "".join(lines), encoding="utf-8")
    expected = {f"v{i}": value for i, value in enumerate(SCALARS.values())}
    assert repr(by_rcl(file)) == repr(expected) == repr(by_us(file))


def test_not_a_number_is_one():
    assert math.isnan(scalar(".nan"))
    assert math.isnan(scalar("NaN"))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_the_encoding_and_the_ends_of_lines_do_not_matter(tmp_path, encoding, end):
    file = tmp_path / "values.yaml"
    file.write_bytes(TEXT.replace("\n", end).encode(encoding))
    assert by_us(file) == by_rcl(file) == {"a.b": 1, "c": "grün"}
    assert read_yaml(file) == {"/**": {"ros__parameters": {"a": {"b": 1}, "c": "grün"}}}


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16-le"])
def test_another_encoding_is_refused_with_its_line(tmp_path, encoding):
    file = tmp_path / "values.yaml"
    file.write_bytes(TEXT.encode(encoding))
    with pytest.raises(RCLError):
        by_rcl(file)
    with pytest.raises(FileError, match="is neither UTF-8 nor UTF-16 text") as error:
        by_us(file)
    assert error.value.line == (4 if encoding == "latin-1" else 1)


@pytest.mark.parametrize(("text", "values"), TAKEN.items())
def test_a_node_gets_the_sections_that_are_for_it(tmp_path, text, values):
    file = tmp_path / "values.yaml"
    file.write_text(text)
    assert by_us(file) == by_rcl(file) == values


@pytest.mark.parametrize(("text", "why"), REFUSED.items())
def test_what_ros_refuses_is_refused_in_one_line_with_its_place(tmp_path, text, why):
    file = tmp_path / "values.yaml"
    file.write_text(text)
    with pytest.raises(RCLError):
        by_rcl(file)
    with pytest.raises(FileError, match=why[1]) as error:
        by_us(file)
    assert str(error.value).startswith(f"{file}:{why[0]}: ")
    assert "\n" not in str(error.value)


def test_a_file_that_cannot_be_read_is_named_with_the_reason(tmp_path):
    with pytest.raises(FileError, match=f"{tmp_path}: Is a directory"):
        read_yaml(tmp_path)


def test_a_key_that_is_given_twice_is_refused_where_its_first_value_would_be_lost(tmp_path):
    file = tmp_path / "scene.yaml"
    file.write_text("walls: []\nposts: []\nwalls: []\n")
    with pytest.raises(FileError, match=":3: 'walls' is given twice"):
        read_yaml(file)


def test_a_value_that_contains_itself_is_refused(tmp_path):
    file = tmp_path / "scene.yaml"
    file.write_text("a: &x [*x]\n")
    with pytest.raises(FileError, match=":1: contains itself"):
        read_yaml(file)
