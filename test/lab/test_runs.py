"""Each benchmark and each experiment runs, prints its table, and writes what it printed."""

import json

import pytest

from omniman_ros.cli.main import main

pytestmark = [pytest.mark.exhaustive, pytest.mark.processes]

BENCHMARKS = (
    "control",
    "path",
    "mpc",
    "can",
    "arm",
    "whole_body",
    "whole_body_obstacles",
    "whole_body_running",
    "tracker",
    "clutter",
    "crowd",
    "world",
)
FEW = {"clutter": ["--worlds", "2"], "crowd": ["--worlds", "1"]}
IN_WORLD = ("whole_body_obstacles", "whole_body_running", "tracker", "clutter", "crowd", "world")
EXPERIMENTS = ("coupling", "odometry", "tool_path", "free", "handover", "workshop")


def written(capfd, folder, name):
    """Return the result, which is the last line printed and the file of that name."""
    *report, said = capfd.readouterr().out.splitlines()
    result = json.loads(said)
    assert result == json.loads((folder / f"{name}.json").read_text())
    assert len(report) > 3
    return result


@pytest.mark.parametrize("name", BENCHMARKS)
def test_a_benchmark_measures(name, tmp_path, capfd, own_domain):
    if name in IN_WORLD:
        pytest.importorskip("mujoco")
    words = ["--quick", *FEW.get(name, []), "--results", str(tmp_path)]
    assert main(["bench", name, *words]) == 0
    result = written(capfd, tmp_path, f"bench_{name}")
    assert all(value in (True, False, None) for value in result.get("aims", {}).values())


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_experiment_passes(name, tmp_path, capfd):
    assert main(["reproduce", name, "--quick", "--results", str(tmp_path)]) == 0
    assert written(capfd, tmp_path, f"reproduce_{name}")["quick"] is True


@pytest.mark.parametrize("name", ["coupling", "odometry", "tool_path", "free", "handover"])
def test_an_experiment_runs_in_the_physics_world(name, tmp_path, capfd):
    pytest.importorskip("mujoco")
    main(["reproduce", name, "--quick", "--world", "--results", str(tmp_path)])
    assert written(capfd, tmp_path, f"reproduce_{name}_rollers")["world"] == "rollers"


def test_the_body_dodges(tmp_path, capfd):
    pytest.importorskip("mujoco")
    assert main(["reproduce", "dodge", "--quick", "--results", str(tmp_path)]) == 0
    (drive,) = written(capfd, tmp_path, "reproduce_dodge_rollers")["drives"]
    assert drive["tool_m"] > 1.9


def test_random_scenes_are_driven(tmp_path, capfd):
    words = ["--seeds", "0:2", "--jobs", "1", "--solve-time", "0.01", "--results", str(tmp_path)]
    assert main(["reproduce", "scenes", *words]) == 0
    assert written(capfd, tmp_path, "reproduce_scenes")["failed"] == []
