"""The commands of the laboratory: one table gives their options, their help and their pages."""

import importlib
import json
import re

import pytest

from omniman_ros.cli.main import main, make_parser
from omniman_ros.core.parameters import specs
from omniman_ros.extras import WORLD
from omniman_ros.lab import command, registry
from omniman_ros.lab.registry import BENCHMARKS, EXPERIMENTS, Study
from omniman_ros.lab.reproduce import all_experiments
from omniman_ros.simulation.world.parameters import WorldParameters
from test import robots
from test.config.documented import ROOT

STUDIES = [("bench", name) for name in BENCHMARKS] + [("reproduce", name) for name in EXPERIMENTS]


@pytest.mark.parametrize(("kind", "name"), STUDIES)
def test_every_command_has_a_module_and_shows_its_own_options_only(kind, name, capsys):
    study = (BENCHMARKS if kind == "bench" else EXPERIMENTS)[name]
    assert callable(importlib.import_module(f"omniman_ros.lab.{study.module}").run)
    with pytest.raises(SystemExit) as end:
        main([kind, name, "--help"])
    assert end.value.code == 0
    shown = set(re.findall(r"^  (?:-p NAME:=VALUE, )?(--[\w-]+)", capsys.readouterr().out, re.M))
    own = {flag for flag, _ in study.options} | {f"--{effort}" for effort in study.efforts}
    assert shown - {"--param"} == own | {"--results"} | ({"--robot"} if study.robot else set())


@pytest.mark.parametrize("kind", ["bench", "reproduce"])
def test_the_page_of_commands_names_all_of_them(kind):
    names = BENCHMARKS if kind == "bench" else EXPERIMENTS
    assert f"```{{lab}} {kind}" in (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert [line.split("`")[1] for line in registry.markdown(kind) if "`" in line] == [
        f"omniman {kind} {name}" for name in names
    ]


PAGES = sorted({*(ROOT / "docs").glob("**/*.md"), *(ROOT / "docs" / "results").glob("*.json")})


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_a_command_that_is_gone_names_the_tag_that_had_it(path):
    if path.name == "changelog.md":
        return
    text = path.read_text(encoding="utf-8")
    for found in re.finditer(r"omniman (bench|reproduce) (\w+)", text):
        known = BENCHMARKS if found[1] == "bench" else EXPERIMENTS
        near = text[max(found.start() - 60, 0) : found.end() + 60]
        assert found[2] in {*known, "NAME"} or "lab-2026-11" in near, found[0]


@pytest.mark.parametrize(
    "words",
    [
        ["bench"],
        ["reproduce", "nothing"],
        ["reproduce", "coupling", "--quick", "--full"],
        ["reproduce", "tool_path", "--full"],
        ["bench", "clutter", "--minutes", "3"],
        ["bench", "soak", "--trials", "3"],
    ],
)
def test_what_a_command_does_not_take_is_a_usage_error(words, capsys):
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2


def test_negative_seed_is_a_usage_error(capsys):
    assert main(["reproduce", "free", "--quick", "--seed", "-1"]) == 2
    assert "--seed" in capsys.readouterr().err


def test_each_experiment_has_its_robot(monkeypatch):
    asked = []
    stub = type("module", (), {"run": staticmethod(lambda args: asked.append(args.robot) or 0)})
    monkeypatch.setattr(command.importlib, "import_module", lambda name: stub)
    monkeypatch.setattr(type(WORLD), "is_available", property(lambda extra: True))
    for words in (["coupling"], ["free", "--robot", "mine.yaml"], ["scenes"]):
        assert command.run(make_parser().parse_args(["reproduce", *words])) == 0
    assert asked == ["omniman", "mine.yaml", "ig42"]


def test_without_the_engine_the_world_is_refused_with_the_way_to_get_it(monkeypatch, capsys):
    monkeypatch.setattr(type(WORLD), "is_available", property(lambda extra: False))
    assert main(["reproduce", "coupling", "--world"]) == 1
    assert "mujoco-core" in capsys.readouterr().err


def test_robot_with_three_wheels_has_no_coupling_error(capsys, tmp_path):
    words = ["--quick", "--robot", robots.path("omni3"), "--results", str(tmp_path)]
    assert main(["reproduce", "coupling", *words]) == 1
    assert "no motion constraint" in capsys.readouterr().err


def test_the_kinds_of_wheels_on_the_command_line_are_those_of_the_world():
    (wheels,) = (spec for spec in specs(WorldParameters) if spec.name == "wheels")
    assert set(registry.WHEELS) == set(wheels.choices)


def test_all_runs_each_experiment_with_its_defaults_and_goes_on_after_a_failure(
    monkeypatch, tmp_path, capsys
):
    """What it hands over is what the command line would, so that no option is missing."""
    called = {}

    def module(name):
        def run(args):
            called[args.name] = vars(args)
            if args.name == "odometry":
                raise command.CommandError("the floor is lava")
            return int(args.name == "free")

        return type("module", (), {"run": staticmethod(run)})

    monkeypatch.setattr(all_experiments.importlib, "import_module", module)
    words = ["--quick", "--seed", "3", "--results", str(tmp_path)]
    args = make_parser().parse_args(["reproduce", "all", *words])
    assert all_experiments.run(args) == 1
    assert list(called) == [name for name in EXPERIMENTS if name != "all"]
    for name, given in called.items():
        parsed = vars(make_parser().parse_args(["reproduce", name, *words]))
        parsed["robot"] = EXPERIMENTS[name].robot
        own = {key: value for key, value in parsed.items() if key not in ("command", "version")}
        assert {key: given[key] for key in own} == own
    result = json.loads((tmp_path / "reproduce_all.json").read_text())["experiments"]
    assert [name for name, row in result.items() if not row["passed"]] == ["odometry", "free"]
    said = capsys.readouterr().out
    assert "the floor is lava" in said and "FAILED" in said


def test_a_study_without_options_still_has_the_common_arguments():
    given = Study("bench.path", "paths").defaults("path", quick=True)
    assert (given.name, given.quick, given.full, given.robot) == ("path", True, False, "omniman")
