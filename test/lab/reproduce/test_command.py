import argparse
import importlib.util
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.cli.main import main
from omniman_ros.core.parameters import build
from omniman_ros.lab.reproduce import cases, command, coupling, energies
from omniman_ros.lab.reproduce.experiments import EXPERIMENTS
from omniman_ros.lab.studies.coupling import Case, Outcome, Run, Setup
from omniman_ros.lab.studies.coupling_sweep import QUICK, summary
from omniman_ros.lab.studies.kinematic_comparison import Comparison
from omniman_ros.lab.studies.mpc_cases import Scene, Variant, circle
from omniman_ros.lab.studies.planned_drives import drive_with_planner
from omniman_ros.lab.studies.recorded_drive import StudyError
from omniman_ros.motion.figure7 import Figure7
from omniman_ros.planning.cases import TwoVelocityPath
from omniman_ros.simulation.plant.parameters import MismatchParameters
from test import robots
from test.running import command as omniman
from test.running import environment
from test.tiers import exhaustive

DRAWS = importlib.util.find_spec("matplotlib") is not None


def made(group, sample, gain, factor=1.0):
    """Make a drive without driving."""
    outcome = Outcome(**dict.fromkeys(Outcome.__dataclass_fields__, factor / (1.0 + gain)))
    time = np.linspace(0, QUICK.figure.duration, 50)
    epsilon = np.outer(np.sin(time), [outcome.epsilon_max])
    return Run(Case(group, sample, gain, build(MismatchParameters, {})), outcome, time, epsilon)


@pytest.fixture
def runs():
    return [made("P", sample, gain, 1.0 + sample) for sample in range(3) for gain in (0.0, 2.0)]


@pytest.fixture
def result(runs):
    steps = [
        {
            "k": k,
            "delay_s": delay,
            "lifted": lifted,
            "overshoot": 0.02 * k,
            "swing": 0.0,
            "settled": k * delay < 1,
        }
        for k in (2.0, 30.0)
        for delay in (0.0, 0.05)
        for lifted in (True, False)
    ]
    margin = {"k": 30.0, "computed_s": 0.046, "settles_s": 0.0, "oscillates_s": 0.05}
    return {
        "samples": 3,
        "chosen_gain": 2.0,
        "printed_gain": 63.0,
        "table": summary(runs),
        "late_commands": steps,
        "stability": {
            "boundary": [{"delay_s": 0.0, "k": None}, {"delay_s": 0.05, "k": 28.0}],
            "margins": [margin],
            "compared": 4,
            "agree": 3,
        },
        "aim": {"ratio": 0.1, "reached": 1 / 3, "met": False},
        "picture": None,
    }


@pytest.mark.exhaustive
@pytest.mark.processes
def test_command_runs_end_to_end_and_publishes_its_json(tmp_path):
    ended = subprocess.run(
        omniman("reproduce", "coupling", "--quick", "--results", str(tmp_path)),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    result = json.loads(ended.stdout.splitlines()[-1])
    assert result == json.loads((tmp_path / "reproduce_coupling.json").read_text())
    assert (tmp_path / "reproduce_coupling.png").exists() is DRAWS
    assert result["path"]["movements"][0] == "forwards"
    assert result["path"]["duration_s"] == pytest.approx(QUICK.figure.duration, rel=1e-3)
    off, paper, chosen, corrected, printed = result["table"]
    assert [row["k"] for row in (off, paper, chosen)] == [0.0, 2.0, result["chosen_gain"]]
    assert [row["k"] for row in (corrected, printed)] == [2.0, result["printed_gain"]]
    assert printed["epsilon_ratio"]["mean"] < 0.1 < corrected["epsilon_ratio"]["mean"]
    assert result["stability"]["agree"] == result["stability"]["compared"]
    assert off["epsilon_max"]["mean"] > 2 * paper["epsilon_max"]["mean"]
    assert paper["slip"]["mean"] > chosen["slip"]["mean"] > 0.0
    assert result["aim"]["reached"] == chosen["epsilon_ratio"]["mean"]
    assert "max |eps| at k" in ended.stdout


def test_report_has_a_row_for_each_gain_and_marks_oscillation(result):
    text = "\n".join(coupling.report(result))
    assert "P velocity loops, mean of 3 sets of wheels:" in text
    assert "2.000 rad" in text  # off: mean of 1, 2 and 3
    assert "0.667 rad" in text  # k = 2
    assert "oscillates" in text
    assert "46 ms" in text and "agree on 3 of 4" in text
    assert "MISSED" in text


def test_reached_is_the_mean_ratio_of_p_loops_at_the_chosen_gain(runs):
    worse = [made("P", 3, 0.0), made("P", 3, 2.0, 2.0)]
    rows = summary([*runs, *worse, *(made("PI", 0, gain, 7.0) for gain in (0.0, 2.0, 5.0))])
    assert coupling.remaining_ratio(rows, 2.0) == pytest.approx((3 * 1 / 3 + 2 / 3) / 4)


def test_each_movement_has_its_largest_change_of_the_uncontrolled_error(runs):
    figure = QUICK.figure
    time = np.arange(0.0, figure.duration, 0.02)
    third = figure.legs(0.0)[2]
    jump = np.where(time > third.begin + 1.0, 0.5, 0.0)  # in the third movement, and afterwards
    off = [replace(made("P", n, 0.0), time=time, epsilon=np.outer(jump, [n])) for n in (1, 3)]
    controlled = replace(made("P", 1, 2.0), time=time, epsilon=np.outer(time, [9.0]))
    other = replace(made("PI", 1, 0.0), time=time, epsilon=np.outer(time, [9.0]))
    peaks = coupling.movement_peaks(figure, [*off, controlled, other])
    assert list(peaks) == ["forwards", "sideways", "backwards", "circle 1", "circle 2"]
    assert list(peaks.values()) == pytest.approx([0.0, 0.0, 1.0, 0.0, 0.0])
    assert coupling.movement_peaks(figure, [controlled, other]) == {}


def test_without_matplotlib_there_is_no_picture(monkeypatch, runs, result, tmp_path):
    monkeypatch.delattr("omniman_ros.lab.figures.coupling", raising=False)
    monkeypatch.setitem(sys.modules, "omniman_ros.lab.figures.coupling", None)
    assert coupling.draw(robots.robot(), QUICK, runs, result, tmp_path) is None
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not DRAWS, reason="matplotlib is not installed")
@pytest.mark.parametrize("groups", [exhaustive(("P",)), ("P", "PI", "radii", "ice", "late")])
def test_picture_can_be_drawn_for_any_groups(runs, result, tmp_path, groups):
    every = [
        made(group, sample, gain) for group in groups for sample in range(2) for gain in (0.0, 2.0)
    ]
    result["table"] = summary(every)
    path = coupling.draw(robots.robot(), QUICK, every, result, tmp_path)
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.skipif(not DRAWS, reason="matplotlib is not installed")
def test_picture_shows_the_wheels_with_the_median_error(runs):
    from omniman_ros.lab.figures.coupling import select_median

    assert {run.case.sample for run in select_median(runs)} == {1}
    assert [run.case.gain for run in select_median(runs)] == [0.0, 2.0]


def test_robot_with_three_wheels_is_refused(capsys, tmp_path):
    path = robots.path("omni3")
    assert main(["reproduce", "--quick", "--robot", path, "--results", str(tmp_path)]) == 1
    assert "no motion constraint" in capsys.readouterr().err


def test_quick_and_full_exclude_each_other(capsys):
    with pytest.raises(SystemExit) as end:
        main(["reproduce", "--quick", "--full"])
    assert end.value.code == 2
    assert "not allowed with" in capsys.readouterr().err


def test_negative_seed_is_a_usage_error(capsys):
    assert main(["reproduce", "--quick", "--seed", "-1"]) == 2
    assert "--seed" in capsys.readouterr().err


def test_path_in_the_json_is_the_driven_path():
    path = coupling.describe_path(QUICK)
    assert path["travel_m"] == pytest.approx(QUICK.figure.length * (3 + 1.5 * np.pi))
    assert path["duration_s"] == QUICK.figure.duration
    assert Setup(robots.values(), Figure7()).figure.duration > path["duration_s"]


# ---- MPC 2021 -----------------------------------------------------------------------------------

BESIDE = (circle(0.3, TwoVelocityPath((0.2, 0.9))),)
SHORT = Scene("corridor", (0.3, 0.0, 0.0), obstacles=BESIDE)


@pytest.fixture(scope="module")
def ride():
    """Return a drive of 0.3 m past a circle."""
    ticks = iter(range(10**6))
    return drive_with_planner(robots.values("ig42"), SHORT, timer=lambda: 1e-3 * next(ticks))


def case(monkeypatch, tmp_path, ride, name="corridor", draws=False, **options):
    """Run a case in which every drive yields one recorded drive; a picture takes half a second."""
    asked = []
    if not draws:
        monkeypatch.setattr(cases, "draw_case", lambda *_: {"picture": None, "film": None})

    def driven(robot, scene, voltages, seed, timer, wheels):
        asked.append((dict(scene.changes), voltages, seed))
        return ride(len(asked)) if callable(ride) else ride

    monkeypatch.setattr(cases, "drive_with_planner", driven)
    short = replace(cases.CASES[name], scene=lambda: replace(SHORT, name=name))
    monkeypatch.setitem(cases.CASES, name, short)
    args = {"robot": None, "quick": True, "full": False, "seed": 3, "results": str(tmp_path)}
    args["world"] = None
    code = command.run(argparse.Namespace(name=name, **(args | options)))
    return code, json.loads((tmp_path / f"reproduce_{name}.json").read_text()), asked


def collided(ride):
    return replace(ride, drive=replace(ride.drive, gaps=ride.drive.gaps - 0.7))


def short_of(ride):
    return replace(ride, drive=replace(ride.drive, goal=(9.0, 0.0, 0.0)))


def test_case_is_driven_with_both_outputs_and_published(monkeypatch, tmp_path, ride, capsys):
    code, result, asked = case(monkeypatch, tmp_path, ride, draws=True)
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


def test_setting_of_the_paper_is_driven_but_not_judged(monkeypatch, tmp_path, ride):
    _, result, asked = case(monkeypatch, tmp_path, ride, quick=False)
    assert asked[2][0] == dict(cases.PAPER_HORIZON)
    assert result["drives"][2]["counts"] is False


@pytest.mark.parametrize(
    ("direction", "share"), [(0.0, 0.0), (1.5, 0.0), (1.6, 1.0), (np.pi, 1.0)]
)
def test_travel_counts_as_backwards_beyond_a_quarter_turn(ride, direction, share):
    twists = np.tile([np.cos(direction), np.sin(direction), 0.0], (10, 1))
    rests = np.zeros((5, 3))
    drive = replace(ride.drive, times=np.arange(15.0), twists=np.vstack([twists, rests]))
    assert cases.backward_share(drive) == share
    assert cases.backward_share(replace(drive, twists=np.zeros((15, 3)))) == 0.0


@pytest.mark.parametrize("spoil", [collided, short_of])
def test_contact_or_unreached_goal_is_a_failure(monkeypatch, tmp_path, ride, spoil, capsys):
    code, result, _ = case(monkeypatch, tmp_path, spoil(ride))
    assert code == 1
    assert result["passed"] is False
    assert "FAILED" in capsys.readouterr().out


def test_contact_with_changed_parameters_is_not_a_failure(monkeypatch, tmp_path, ride, capsys):
    code, result, _ = case(
        monkeypatch, tmp_path, lambda n: collided(ride) if n == 3 else ride, quick=False
    )
    assert code == 0
    assert [row["collided"] for row in result["drives"]] == [False, False, True]
    assert "CONTACT" in capsys.readouterr().out


@pytest.mark.exhaustive
@pytest.mark.skipif(not DRAWS, reason="matplotlib is not installed")
def test_case_with_moving_obstacles_also_has_a_film(monkeypatch, tmp_path, ride):
    _, result, _ = case(monkeypatch, tmp_path, ride, "moving", draws=True)
    assert (tmp_path / "reproduce_moving.gif").read_bytes()[:4] == b"GIF8"
    assert result["film"].endswith("reproduce_moving.gif")


class Here:
    """Stand-in for a process pool that runs in this process."""

    def __init__(self, *_):
        self.map = map

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


def test_free_case_has_the_table_of_energies(monkeypatch, tmp_path, ride, capsys):
    def compared(robot, distance, bearing, changes, both, wheels):
        if distance > 2.0:
            raise StudyError("not at the same time")
        return Comparison(distance, bearing, 3.0, 30.0, 0.1, 40.0, float("nan"), 0.01)

    monkeypatch.setattr(energies, "compare", compared)
    monkeypatch.setattr(energies, "ProcessPoolExecutor", Here)
    monkeypatch.setattr(cases, "variants", lambda _: [Variant("defaults")])
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
    monkeypatch.delattr("omniman_ros.lab.figures.mpc", raising=False)
    monkeypatch.setitem(sys.modules, "omniman_ros.lab.figures.mpc", None)
    code, result, _ = case(monkeypatch, tmp_path, ride, "moving", draws=True)
    assert code == 0
    assert result["picture"] is None
    assert [path.name for path in tmp_path.iterdir()] == ["reproduce_moving.json"]


def test_workshop_is_driven_and_drawn(monkeypatch, tmp_path, ride):
    code, result, _ = case(monkeypatch, tmp_path, ride, "workshop", draws=True, quick=False)
    assert code == 0
    assert [row["voltages"] for row in result["drives"]] == [False, True]
    assert (result["picture"] is not None) == DRAWS


@pytest.mark.exhaustive
def test_paper_problem_is_driven_drawn_and_published(tmp_path, capsys):
    assert main(["reproduce", "free_paper", "--quick", "--results", str(tmp_path)]) == 0
    result = json.loads((tmp_path / "reproduce_free_paper.json").read_text())
    assert [row["w_pos"] for row in result["drives"]] == [600.0, 20.0]
    assert result["passed"] is True
    assert (tmp_path / "reproduce_free_paper.png").exists() is DRAWS
    assert "Stages that were not solved: 0 of" in capsys.readouterr().out


def test_each_experiment_has_its_robot():
    assert EXPERIMENTS["coupling"].robot == "omniman"
    assert {EXPERIMENTS[name].robot for name in cases.CASES} == {"ig42"}
