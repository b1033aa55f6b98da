import argparse
import os
import shlex
import subprocess
import sys

import pytest

from omniman_ros.cli.main import COMMANDS, main, make_parser
from omniman_ros.nodes.registry import NODES
from omniman_ros.processes import robot_setup
from test.running import command

pytestmark = pytest.mark.processes

HELP = """
import sys
before = set(sys.modules)
from omniman_ros.cli.main import main
for arguments in {arguments!r}:
    try:
        main(arguments)
    except SystemExit as end:
        assert end.code == 0, (arguments, end.code)
    imported = set(sys.modules) - before
    own = {{name for name in imported if name.partition(".")[0] == "omniman_ros"}}
    others = {{name.partition(".")[0] for name in imported - own}}
    heavy = others - sys.stdlib_module_names | others & {{"asyncio", "subprocess"}}
    assert not heavy, (arguments, heavy)
    assert len(own) < {modules} and len(imported) < 2 * {modules}, (arguments, len(own))
"""  #: Program that prints help, and after each help looks at what was imported


def test_help_imports_nothing_heavy():
    arguments = [["--help"], *[[name, "--help"] for name in COMMANDS]]
    code = HELP.format(arguments=arguments, modules=40)
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.count("usage: omniman") == len(arguments)


def parsers(parser):
    """Yield a parser and all parsers of its subcommands."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from parsers(below)


def test_each_help_ends_with_two_examples_that_are_valid():
    top, *others = parsers(make_parser())
    assert len(others) > len(COMMANDS)
    for parser in others:
        head, *examples = parser.format_help().partition("examples:")[2].splitlines()
        assert not head and len(examples) == 2, parser.prog
        for example in examples:
            program, *arguments = shlex.split(example)
            assert program == "omniman" and example.strip().startswith(parser.prog), example
            if "--help" not in arguments:
                top.parse_args(arguments)


@pytest.mark.parametrize(
    ("line", "completions"),
    [
        ("omniman ider", set()),
        ("omniman ide", {"identify"}),
        ("omniman bench cl", {"clutter"}),
        (
            "omniman bench clutter --",
            {"--help", "--quick", "--results", "--worlds", "--jobs", "--dask", "--seed"},
        ),
        ("omniman parameters mpc", {"mpc_planner"}),
    ],
)
def test_a_shell_completes_a_command_line(line, completions, tmp_path):
    answers = tmp_path / "answers"
    asked = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answers),
        "_ARGCOMPLETE_IFS": "\n",
    }
    position = {"COMP_LINE": line, "COMP_POINT": str(len(line)), "COMP_TYPE": "9"}
    program = [sys.executable, "-m", "omniman_ros.cli.main"]
    assert subprocess.run(program, env={**os.environ, **asked, **position}).returncode == 0
    assert {answer.strip() for answer in answers.read_text().split("\n")} - {""} == completions


def test_version_is_printed(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith("omniman ")


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["fly"],
        ["up", "--only"],
        ["bench", "nothing"],
        ["teleop", "--linear", "fast"],
        ["parameters", "no_node"],
        ["up", "--rob", "ig42"],
    ],
)
def test_an_invalid_command_line_gives_exit_code_2(arguments, capsys):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
    assert "omniman" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["up", "--robot", "nobody"], "robot 'nobody': must be one of ig42, omniman"),
        (["demo", "--robot", "/nowhere/robot.yaml"], "no such file"),
        (["bench", "control", "--robot", "nobody"], "robot 'nobody'"),
        (["up", "--only", "nothing"], "no node 'nothing'; there are platform_controller"),
        (["up", "-p", "drive.mode=torque"], "'drive.mode=torque' is not NAME:=VALUE"),
        (["up", "--params-file", "/nowhere"], "no parameter file '/nowhere'"),
        (["teleop", "--linear", "0"], "--linear must be above 0, got 0"),
    ],
)
def test_what_prevents_a_start_is_reported_in_one_line(arguments, message, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "words"), [("stop", "ROS 2 is not installed"), ("record", "Python module 'rclpy")]
)
def test_without_rclpy_the_error_says_how_to_get_it(name, words):
    code = (
        "import sys\n"
        "sys.modules['rclpy'] = None\n"
        "from omniman_ros.cli.main import main\n"
        f"sys.exit(main([{name!r}]))\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.returncode == 1
    assert words in ended.stderr
    assert "source /opt/ros" in ended.stderr


def test_teleop_without_a_terminal_is_refused():
    ended = subprocess.run(
        command("teleop"), stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    assert ended.returncode == 2
    assert "not a terminal" in ended.stderr


def test_up_can_start_every_node_of_the_package():
    assert {kind.name for kind in robot_setup.ROBOT_NODES} == set(NODES)
