import argparse
import importlib.util
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import omniman_ros.cli
from omniman_ros.cli import reproduce
from omniman_ros.cli.main import main
from omniman_ros.core.parameters import build
from omniman_ros.drive.parameters import Mismatch
from omniman_ros.planning.cases import Turned
from omniman_ros.studies.coupling import Case, Outcome, Run, Setup
from omniman_ros.studies.coupling_sweep import QUICK, summary
from omniman_ros.studies.figure7 import Figure7
from omniman_ros.studies.mpc_cases import (
    Comparison,
    Scene,
    StudyError,
    Variant,
    circle,
    planned,
)
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


@pytest.mark.processes
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


def test_each_movement_has_its_largest_change_of_the_uncontrolled_error(runs):
    figure = QUICK.figure
    time = np.arange(0.0, figure.duration, 0.02)
    third = figure.legs(0.0)[2]
    jump = np.where(time > third.begin + 1.0, 0.5, 0.0)  # in the third movement, and it stays
    off = [replace(made("P", n, 0.0), time=time, epsilon=np.outer(jump, [n])) for n in (1, 3)]
    controlled = replace(made("P", 1, 2.0), time=time, epsilon=np.outer(time, [9.0]))
    other = replace(made("PI", 1, 0.0), time=time, epsilon=np.outer(time, [9.0]))
    peaks = reproduce.movement_peaks(figure, [*off, controlled, other])
    assert list(peaks) == ["forwards", "sideways", "backwards", "circle 1", "circle 2"]
    assert list(peaks.values()) == pytest.approx([0.0, 0.0, 1.0, 0.0, 0.0])
    assert reproduce.movement_peaks(figure, [controlled, other]) == {}


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


# ---- MPC 2021 -----------------------------------------------------------------------------------

BESIDE = (circle(0.3, Turned((0.2, 0.9))),)
SHORT = Scene("corridor", (0.3, 0.0, 0.0), obstacles=BESIDE)


@pytest.fixture(scope="module")
def ride():
    """A drive of 0.3 m past a circle."""
    ticks = iter(range(10**6))
    return planned(robots.values("ig42"), SHORT, timer=lambda: 1e-3 * next(ticks))


def case(monkeypatch, tmp_path, ride, name="corridor", **options):
    """Run a case whose drives all come out as one that was driven before."""
    asked = []

    def driven(robot, scene, voltages, seed, timer):
        asked.append((dict(scene.changes), voltages, seed))
        return ride(len(asked)) if callable(ride) else ride

    monkeypatch.setattr(reproduce, "planned", driven)
    monkeypatch.setitem(reproduce.SCENES, name, lambda: replace(SHORT, name=name))
    args = {"robot": None, "quick": True, "full": False, "seed": 3, "results": str(tmp_path)}
    code = reproduce.run(argparse.Namespace(name=name, **(args | options)))
    return code, json.loads((tmp_path / f"reproduce_{name}.json").read_text()), asked


def collided(ride):
    return replace(ride, drive=replace(ride.drive, gaps=ride.drive.gaps - 0.7))


def short_of(ride):
    return replace(ride, drive=replace(ride.drive, goal=(9.0, 0.0, 0.0)))


def test_a_case_is_driven_with_both_outputs_and_told_in_json(monkeypatch, tmp_path, ride, capsys):
    code, result, asked = case(monkeypatch, tmp_path, ride)
    assert code == 0
    assert asked == [({}, False, 3), ({}, True, 3)]
    assert result["robot"] == "ig42"
    first = result["drives"][0]
    assert first["reached"] is True
    assert first["collided"] is False
    assert first["clearance_m"] == pytest.approx(0.35, abs=0.02)
    assert first["cpu_median_ms"] == pytest.approx(2.0)
    assert first["plans_used"] <= first["cycles"]
    text = capsys.readouterr().out
    assert "passed" in text
    assert json.loads(text.splitlines()[-1]) == result
    assert (tmp_path / "reproduce_corridor.png").exists() is DRAWS


def test_the_paper_s_setting_is_shown_too(monkeypatch, tmp_path, ride):
    _, result, asked = case(monkeypatch, tmp_path, ride, quick=False)
    assert asked[2][0] == dict(reproduce.PAPER)
    assert result["drives"][2]["counts"] is False


@pytest.mark.parametrize(
    ("direction", "share"), [(0.0, 0.0), (1.5, 0.0), (1.6, 1.0), (np.pi, 1.0)]
)
def test_backwards_is_with_the_direction_of_travel_behind_the_side(ride, direction, share):
    twists = np.tile([np.cos(direction), np.sin(direction), 0.0], (10, 1))
    rests = np.zeros((5, 3))
    drive = replace(ride.drive, times=np.arange(15.0), twists=np.vstack([twists, rests]))
    assert reproduce.backwards(drive) == share
    assert reproduce.backwards(replace(drive, twists=np.zeros((15, 3)))) == 0.0


@pytest.mark.parametrize("spoil", [collided, short_of])
def test_contact_or_a_goal_not_reached_is_a_failure(monkeypatch, tmp_path, ride, spoil, capsys):
    code, result, _ = case(monkeypatch, tmp_path, spoil(ride))
    assert code == 1
    assert result["passed"] is False
    assert "FAILED" in capsys.readouterr().out


def test_what_another_setting_does_is_no_failure_of_ours(monkeypatch, tmp_path, ride, capsys):
    code, result, _ = case(
        monkeypatch, tmp_path, lambda n: collided(ride) if n == 3 else ride, quick=False
    )
    assert code == 0
    assert [row["collided"] for row in result["drives"]] == [False, False, True]
    assert "CONTACT" in capsys.readouterr().out


@pytest.mark.skipif(not DRAWS, reason="matplotlib is not installed")
def test_moving_obstacles_are_shown_as_a_film_too(monkeypatch, tmp_path, ride):
    _, result, _ = case(monkeypatch, tmp_path, ride, "moving")
    assert (tmp_path / "reproduce_moving.gif").read_bytes()[:4] == b"GIF8"
    assert result["film"].endswith("reproduce_moving.gif")


class Here:
    """Stands for a pool of processes."""

    def __init__(self, *_):
        self.map = map

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


def test_the_free_case_has_the_table_of_energies(monkeypatch, tmp_path, ride, capsys):
    def compared(robot, distance, bearing, changes, both):
        if distance > 2.0:
            raise StudyError("not at the same time")
        return Comparison(distance, bearing, 3.0, 30.0, 0.1, 40.0, float("nan"), 0.01)

    monkeypatch.setattr(reproduce, "compare", compared)
    monkeypatch.setattr(reproduce, "ProcessPoolExecutor", Here)
    monkeypatch.setattr(reproduce, "variants", lambda _: [Variant("defaults")])
    code, result, _ = case(monkeypatch, tmp_path, ride, "free", quick=False)
    assert code == 0
    rows = {(row["distance_m"], row["bearing_deg"]): row for row in result["energy"]}
    assert len(rows) == 9
    assert rows[2.0, 90.0]["ratio"] == 0.75
    assert rows[4.0, 0.0]["fault"] == "not at the same time"
    assert rows[4.0, 0.0]["ratio"] is None
    text = capsys.readouterr().out
    assert "0.75" in text
    assert "not at the same time" in text


def test_without_matplotlib_a_case_has_no_picture(monkeypatch, tmp_path, ride):
    monkeypatch.setitem(sys.modules, "omniman_ros.cli.mpc_picture", None)
    monkeypatch.delattr(omniman_ros.cli, "mpc_picture", raising=False)
    code, result, _ = case(monkeypatch, tmp_path, ride, "moving")
    assert code == 0
    assert result["picture"] is None
    assert [path.name for path in tmp_path.iterdir()] == ["reproduce_moving.json"]


def test_the_workshop_is_driven_and_drawn(monkeypatch, tmp_path, ride):
    code, result, _ = case(monkeypatch, tmp_path, ride, "workshop", quick=False)
    assert code == 0
    assert [row["voltages"] for row in result["drives"]] == [False, True]
    assert (result["picture"] is not None) == DRAWS


def test_each_experiment_has_its_robot():
    assert reproduce.ROBOTS["coupling"] == "omniman"
    assert {reproduce.ROBOTS[name] for name in reproduce.SCENES} == {"ig42"}
