"""The README against the code."""

import re
from pathlib import Path

from omniman_ros.cli.main import COMMANDS
from omniman_ros.cli.parameters import tables
from omniman_ros.nodes.registry import NODES

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")


def test_parameter_tables_are_those_of_the_code():
    """`omniman parameters` prints what belongs between the two comments."""
    begin, rest = README.split("checked by test/test_readme.py -->", 1)
    assert rest.split("<!-- end of parameters -->")[0].strip() == tables().strip()


def test_every_command_is_in_the_table_of_commands():
    told = set(re.findall(r"`omniman (\w+)", README))
    assert set(COMMANDS) <= told
    assert told <= set(COMMANDS)


def test_every_node_has_a_section():
    for node in NODES:
        assert f"### {node}\n" in README
