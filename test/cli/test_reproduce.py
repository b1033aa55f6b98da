import importlib.util
import json
import subprocess
import sys

import numpy as np
import pytest

from omniman_ros.cli import reproduce
from omniman_ros.cli.main import main
from omniman_ros.core.parameters import build
from omniman_ros.drive.parameters import Mismatch
from omniman_ros.studies.coupling import Case, Outcome, Run, Setup
from omniman_ros.studies.coupling_sweep import QUICK, summary
from omniman_ros.studies.figure7 import Figure7
from test import robots

from .support import command, environment

DRAWS = importlib.util.find_spec("matplotlib") is not None


def made(group, sample, gain, factor=1.0):
    """A drive that was not driven."""
    outcome = Outcome(**dict.fromkeys(Outcome.__dataclass_fields__, factor / (1.0 + gain)))
    time = np.linspace(0, QUICK.figure.duration, 50)
    epsilon = np.outer(np.sin(time), [outcome.epsilon_max])
    return Run(Case(group, sample, gain, build(Mismatch, {})), outcome, time, epsilon)


@pytest.fixture
def runs():
    return [made("P", sample, gain, 1.0 + sample) for sample in range(3) for gain in (0.0, 2.0)]


@pytest.fixture
def result(runs):
    steps = [
        {"k": k, "delay_s": delay, "overshoot": 0.02 * k, "swing": 0.0, "settled": k * delay < 1}
        for k in (2.0, 30.0)
        for delay in (0.0, 0.05)
    ]
    return {
        "samples": 3, "chosen_gain": 2.0, "table": summary(runs), "late_commands": steps,
        "aim": {"ratio": 0.1, "reached": 1 / 3, "met": False}, "picture": None,
    }  # fmt: skip


def test_the_command_runs_whole_and_says_so_in_json(tmp_path):
    ended = subprocess.run(
        command("reproduce", "coupling", "--quick", "--results", str(tmp_path)),
        env=environment(), capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout + ended.stderr
    result = json.loads(ended.stdout.splitlines()[-1])
    assert result == json.loads((tmp_path / "reproduce_coupling.json").read_text())
    assert (tmp_path / "reproduce_coupling.png").exists() is DRAWS
    assert result["path"]["movements"][0] == "forwards"
    assert result["path"]["duration_s"] == pytest.approx(QUICK.figure.duration, rel=1e-3)
    off, paper, chosen = result["table"]
    assert [row["k"] for row in (off, paper, chosen)] == [0.0, 2.0, result["chosen_gain"]]
    assert off["epsilon_max"]["mean"] > 2 * paper["epsilon_max"]["mean"]
    assert paper["slip"]["mean"] > chosen["slip"]["mean"] > 0.0
    assert result["aim"]["reached"] == chosen["epsilon_ratio"]["mean"]
    assert "max |eps| at k" in ended.stdout


def test_the_report_has_a_row_for_each_gain_and_says_what_oscillates(result):
    text = "\n".join(reproduce.report(result))
    assert "P velocity loops, mean of 3:" in text
    assert "2.000 rad" in text  # off: mean of 1, 2 and 3
    assert "0.667 rad" in text  # k = 2
    assert "oscillates" in text
    assert "MISSED" in text


def test_reached_is_the_mean_ratio_of_p_loops_at_the_chosen_gain(runs):
    worse = [made("P", 3, 0.0), made("P", 3, 2.0, 2.0)]
    rows = summary([*runs, *worse, *(made("PI", 0, gain, 7.0) for gain in (0.0, 2.0, 5.0))])
    assert reproduce.reached(rows, 2.0) == pytest.approx((3 * 1 / 3 + 2 / 3) / 4)


def test_without_matplotlib_there_is_no_picture(monkeypatch, runs, result, tmp_path):
    monkeypatch.setitem(sys.modules, "omniman_ros.cli.coupling_picture", None)
    assert reproduce.draw(robots.robot(), QUICK, runs, result, tmp_path) is None
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not DRAWS, reason="matplotlib is not installed")
@pytest.mark.parametrize("groups", [("P",), ("P", "PI", "radii", "ice")])
def test_the_picture_is_drawn_of_any_groups(runs, result, tmp_path, groups):
    every = [made(group, sample, gain) for group in groups for sample in range(2)
             for gain in (0.0, 2.0)]  # fmt: skip
    result["table"] = summary(every)
    path = reproduce.draw(robots.robot(), QUICK, every, result, tmp_path)
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.skipif(not DRAWS, reason="matplotlib is not installed")
def test_shown_are_the_wheels_in_the_middle(runs):
    from omniman_ros.cli.coupling_picture import shown

    assert {run.case.sample for run in shown(runs)} == {1}
    assert [run.case.gain for run in shown(runs)] == [0.0, 2.0]


def test_a_robot_with_three_wheels_is_refused(capsys, tmp_path):
    path = robots.path("omni3")
    assert main(["reproduce", "--quick", "--robot", path, "--results", str(tmp_path)]) == 1
    assert "no motion constraint" in capsys.readouterr().err


def test_quick_and_full_exclude_each_other(capsys):
    with pytest.raises(SystemExit) as end:
        main(["reproduce", "--quick", "--full"])
    assert end.value.code == 2
    assert "not allowed with" in capsys.readouterr().err


def test_a_seed_below_zero_is_a_wrong_command_line(capsys):
    assert main(["reproduce", "--quick", "--seed", "-1"]) == 2
    assert "--seed" in capsys.readouterr().err


def test_the_path_in_the_json_is_the_path_driven():
    path = reproduce.path_of(QUICK)
    assert path["travel_m"] == pytest.approx(QUICK.figure.length * (3 + 1.5 * np.pi))
    assert path["duration_s"] == QUICK.figure.duration
    assert Setup(robots.values(), Figure7()).figure.duration > path["duration_s"]
