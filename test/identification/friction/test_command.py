import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from omniman_ros.cli.main import main
from omniman_ros.console.errors import CommandError
from omniman_ros.core.parameters import build, flatten_mapping
from omniman_ros.core.platform import Friction
from omniman_ros.identification.friction.command import (
    confirm,
    mismatch_parameters,
    true_friction,
)
from omniman_ros.identification.friction.drive_session import DriveNode
from omniman_ros.identification.friction.friction_fit import SteadyRun, identify_friction
from omniman_ros.identification.friction.record import FrictionRecord, Truth, load, save
from omniman_ros.identification.friction.report import parameter_file, report
from omniman_ros.identification.line_reader import EndOfInputError
from omniman_ros.nodes.registry import known_names
from omniman_ros.robots import robot_file
from test.robots import robot

IG42 = robot("ig42")
BACK_EMF, ETA, RESISTANCE = 0.78, 0.66, 1.85
A, B = np.array([0.005, 0.0034, 0.0044, 0.0028]), np.array([0.31, 0.21, 0.275, 0.175])


def recorded(a=A, b=B, seed=4, back_emf=1.0, truth=None):
    """A record of noisy runs as the experiment makes them."""
    rng = np.random.default_rng(seed)
    runs = []
    for value in [18.0, 14.0, 8.0, 2.0, -18.0, -14.0, -8.0, -2.0] * 2:
        speed = np.full(4, value) + rng.normal(0.0, 0.01, 4)
        current = (a * speed + b * np.sign(speed)) / (ETA * BACK_EMF) + rng.normal(0, 1e-3, 4)
        volts = RESISTANCE * current + back_emf * BACK_EMF * speed
        spikes = rng.integers(0, 3, 4)
        runs.append(
            SteadyRun(volts, current, speed, np.full(4, 1e-3), np.ones(4, bool), 75, spikes)
        )
    return FrictionRecord(IG42, tuple(runs), truth)


def test_a_record_is_read_as_it_was_written(tmp_path):
    for record in (recorded(), recorded(truth=Truth(tuple(A.tolist()), tuple(B.tolist())))):
        save(record, tmp_path / "deep" / "runs.json")
        back = load(tmp_path / "deep" / "runs.json")
        assert back.robot == record.robot and back.truth == record.truth
        for one, other in zip(back.runs, record.runs, strict=True):
            for name in ("voltage", "current", "speed", "error", "steady", "spikes", "samples"):
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize(
    "text",
    [
        None,
        "",
        "{}",
        "[1]",
        '{"format": "omniman odometry runs 1"}',
        '{"format": "omniman friction runs 1"}',
    ],
)
def test_a_file_that_is_no_record_is_refused(tmp_path, text, capsys):
    path = tmp_path / "runs.json"
    if text is not None:
        path.write_text(text)
    assert main(["identify", "friction", "--runs", str(path), "--results", str(tmp_path)]) == 2
    assert "contains no recorded runs" in capsys.readouterr().err


def test_recorded_runs_are_fitted_and_written(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    path = tmp_path / "runs.json"
    save(recorded(truth=Truth(tuple(A.tolist()), tuple(B.tolist()))), path)
    assert main(["identify", "friction", "--runs", str(path), "--results", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    result = json.loads(lines[-1])
    assert result == json.loads((tmp_path / "identify_friction.json").read_text())
    assert result["ok"] is True and result["warnings"] == []
    assert any("in the simulation" in line for line in lines)
    tree = yaml.safe_load((tmp_path / "friction.yaml").read_text())
    values = flatten_mapping(tree["/**"]["ros__parameters"])
    assert set(values) == {"friction.viscous", "friction.coulomb"} <= set(known_names())
    loaded = build(Friction, values, "friction.")
    np.testing.assert_allclose(loaded.viscous, A, rtol=0.05)
    np.testing.assert_allclose(loaded.coulomb, B, rtol=0.01)
    assert result["parameters"]["friction.coulomb"] == pytest.approx(loaded.coulomb, rel=1e-3)
    image = (tmp_path / "friction.png").read_bytes()
    assert image.startswith(b"\x89PNG") and len(image) > 20000


def test_recorded_runs_can_be_fitted_with_other_data_of_the_robot(tmp_path, capsys):
    """A gear efficiency of 0.8 instead of 0.66 makes a larger torque of the same currents."""
    path = tmp_path / "runs.json"
    save(recorded(), path)
    changed = tmp_path / "mine.yaml"
    values = yaml.safe_load(robot_file("ig42").read_text(encoding="utf-8"))
    values["/**"]["ros__parameters"]["motor"]["gear_efficiency"] = 0.8
    changed.write_text(yaml.safe_dump(values))
    arguments = ["identify", "friction", "--runs", str(path), "--results", str(tmp_path)]
    assert main([*arguments, "--robot", str(changed)]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])["parameters"]["friction.coulomb"]
    np.testing.assert_allclose(found, B * 0.8 / 0.66, rtol=0.01)


def test_a_motor_constant_that_is_more_than_3_percent_off_gives_a_warning(tmp_path):
    def report_text(factor):
        record = recorded(back_emf=factor)
        return "\n".join(report(record, identify_friction(record.runs, IG42)))

    assert "WARNING" not in report_text(1.01) and "WARNING" not in report_text(0.98)
    assert report_text(1.06).count("WARNING") == 4
    warning = "front_left: N K is 0.8268 V s/rad by voltage, current and speed, +6.0 % off"
    assert warning in report_text(1.06)


def test_directions_that_differ_and_insignificant_friction_are_reported():
    record = recorded(a=np.zeros(4))
    shifted = tuple(
        SteadyRun(
            run.voltage,
            run.current + [0.05, 0, 0, 0],
            run.speed,
            run.error,
            run.steady,
            9,
            run.spikes,
        )
        for run in record.runs
    )
    text = "\n".join(report(record, identify_friction(shifted, IG42)))
    assert "front_left: the directions differ (p = " in text
    assert "front_right: the directions differ" not in text
    assert "a does not differ significantly from 0" in text


def test_the_parameter_file_has_intervals_and_no_negative_values():
    record = recorded(a=np.full(4, -0.002))
    text = parameter_file(identify_friction(record.runs, IG42))
    assert text.count("+-") == 8 + 1
    values = flatten_mapping(yaml.safe_load(text)["/**"]["ros__parameters"])
    assert values["friction.viscous"] == [0.0] * 4
    assert build(Friction, values, "friction.").viscous == (0.0,) * 4


def test_too_few_runs_write_no_file_and_name_the_wheel(tmp_path, capsys):
    path = tmp_path / "runs.json"
    record = recorded()
    save(replace(record, runs=record.runs[:5]), path)
    assert main(["identify", "friction", "--runs", str(path), "--results", str(tmp_path)]) == 1
    assert "'front_left': 1 of 5 runs were steady backwards" in capsys.readouterr().err
    assert not (tmp_path / "friction.yaml").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-p", "plant.lifted:=true"], "-p is for --simulate"),
        (["--levels", "2"], "--levels 2 is not within 3 to 50"),
        (["--rounds", "0"], "--rounds 0"),
        (["--precision", "0"], "--precision 0"),
        (["--precision", "nan"], "--precision nan"),
        (["--simulate", "--robot", "nobody"], "nobody"),
        (["--simulate", "-p", "plant.lifted=true"], "is not NAME:=VALUE"),
    ],
)
def test_a_wrong_option_is_refused_in_one_line(arguments, message, capsys):
    assert main(["identify", "friction", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_the_simulated_robot_differs_from_its_configuration_and_is_noisy():
    names = [text.partition(":=")[0] for text in mismatch_parameters(robot("omni3"))]
    assert names == ["mismatch.friction", "mismatch.torque_constant", "faults.current_noise"]
    truth = true_friction(DriveNode("/drive", {"mismatch.friction": [2.0]}), IG42)
    assert truth == Truth((0.008,) * 4, (0.5,) * 4)


class Typing:
    """Lines from a list."""

    def __init__(self, *lines):
        self._lines = list(lines)

    def next(self, wait):
        wait()
        if not self._lines:
            raise EndOfInputError("no more input")
        return self._lines.pop(0)


def test_the_user_must_confirm_that_the_wheels_are_off_the_floor(capsys):
    asked = Typing("", "no", "maybe", " YES ", "never read")
    confirm(asked, lambda: None)
    assert capsys.readouterr().out.count("Are all wheels off the floor?") == 4
    assert asked.next(lambda: None) == "never read"
    with pytest.raises(CommandError, match="--lifted confirms it"):
        confirm(Typing("no"), lambda: None)


def test_a_stop_while_the_user_is_asked_is_reported_with_its_reason():
    def stopped():
        raise CommandError("the emergency stop is on")

    with pytest.raises(CommandError, match="emergency stop"):
        confirm(Typing("yes"), stopped)
