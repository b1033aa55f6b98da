import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from omniman_ros.cli.main import main
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build, flatten_mapping
from omniman_ros.core.platform import Platform
from omniman_ros.identification.floor.command import floor_drive, other_parameters
from omniman_ros.identification.floor.excitation import (
    LIMIT_FRACTION,
    choose_excitation,
    random_excitation,
)
from omniman_ros.identification.floor.floor_fit import identify_floor
from omniman_ros.identification.floor.record import FloorRecord, load, save
from omniman_ros.identification.floor.regressor import FloorModel, SignWidths
from omniman_ros.identification.floor.solution import find_directions, groups
from omniman_ros.identification.floor.windows import Windows
from omniman_ros.identification.robot_session import Recording, distance_along
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.plant.contact import centre_of_mass
from test import robots
from test.identification.floor.prescribed import prescribed_drive
from test.running import (
    PATIENCE,
    Running,
    command,
    environment,
)
from test.tiers import exhaustive

OMNIMAN = robots.parameters("omniman")
TRUE = robots.robot("omniman", other_parameters(robot_parameters("omniman")))
SLOPE = (0.01, -0.005)


@pytest.fixture(scope="module")
def motion():
    return choose_excitation(OMNIMAN.robot, OMNIMAN.limits, 0.35, 40.0)


@pytest.fixture(scope="module")
def drive(motion):
    return prescribed_drive(TRUE, motion, slope=SLOPE)


def assert_found(found, true):
    mass, com, inertia = centre_of_mass(true)
    values = {name: estimate.value for name, estimate in found.estimates.items()}
    assert values["mass"] == pytest.approx(mass, rel=0.01)
    assert values["com_x"] == pytest.approx(com[0], abs=0.002)
    assert values["com_y"] == pytest.approx(com[1], abs=0.002)
    assert values["inertia"] == pytest.approx(inertia, rel=0.03)
    assert values["gear_efficiency"] == pytest.approx(true.motor.gear_efficiency, rel=0.01)
    return values


def test_masses_friction_gear_and_slope_are_found_on_exact_data(drive):
    found = identify_floor(drive, OMNIMAN.robot)
    values = assert_found(found, TRUE)
    np.testing.assert_allclose([values["slope_x"], values["slope_y"]], SLOPE, atol=2e-4)
    for kind in ("viscous", "coulomb", "roller"):
        assert np.mean(getattr(found.robot.friction, kind)) == pytest.approx(
            np.mean(getattr(TRUE.friction, kind)), rel=0.05
        )
    assert not found.is_efficiency_bounded and found.is_back_emf_measured
    assert ("drag.front_left", "drag.front_right") in found.inseparable
    assert ("drag.rear_left", "drag.rear_right") in found.inseparable
    assert found.robot.arm == OMNIMAN.robot.arm


@pytest.mark.exhaustive
def test_without_voltages_the_motor_constant_is_taken_as_configured(drive):
    blind = replace(drive, voltages=np.full_like(drive.voltages, np.nan))
    found = identify_floor(blind, OMNIMAN.robot)
    assert not found.is_back_emf_measured
    assert_found(found, TRUE)


@pytest.mark.exhaustive
def test_a_drive_without_braking_does_not_tell_efficiency_from_mass(motion):
    """Where friction exceeds the inertial forces, no motor is ever driven."""
    sticky = {"friction.coulomb": [6.0], "motor.gear_efficiency": 0.7}
    true = robots.robot("omniman", sticky)
    found = identify_floor(prescribed_drive(true, motion), OMNIMAN.robot)
    assert ("gear",) in found.inseparable
    assert not found.estimates["gear_efficiency"].is_determined
    assert not found.estimates["mass"].is_determined
    assert found.estimates["com_x"].is_determined
    assert found.estimates["gear_efficiency"].value == OMNIMAN.robot.motor.gear_efficiency
    mass = centre_of_mass(true)[0]
    assert abs(found.estimates["mass"].value - mass) < found.estimates["mass"].half_width


def test_an_efficiency_that_is_taken_as_configured_does_not_move(drive):
    model = FloorModel(OMNIMAN.robot).without_gear()
    back_emf = np.full(4, OMNIMAN.robot.motor.gear_ratio * OMNIMAN.robot.motor.torque_constant)
    windows = Windows(drive.start, drive.end, 0.6, 0.15)
    equations = model.equations(drive, back_emf, windows, SignWidths())
    directions = find_directions(model, equations)
    assert directions.solve(model, equations)[-1] == model.expected[-1]
    assert ("gear",) in groups(model, directions)


@pytest.mark.parametrize("name", ["omniman", exhaustive("ig42"), exhaustive("omni3")])
@pytest.mark.parametrize("reach", [0.3, exhaustive(0.9)])
def test_a_drive_stays_within_the_square_and_the_limits_and_returns(name, reach):
    parameters = robots.parameters(name)
    limits = parameters.limits
    for chosen in (
        choose_excitation(parameters.robot, limits, reach, 30.0),
        random_excitation(parameters.robot, limits, reach, 20.0, 7),
    ):
        poses, velocities, accelerations = chosen.track(np.arange(0.0, chosen.duration, 0.013))
        assert np.abs(poses[:, :2]).max() < 1.01 * reach
        fraction = 1.02 * LIMIT_FRACTION
        assert np.hypot(*velocities[:, :2].T).max() < fraction * limits.linear_velocity
        assert np.hypot(*accelerations[:, :2].T).max() < fraction * limits.linear_acceleration
        assert np.abs(velocities[:, 2]).max() < fraction * limits.angular_velocity
        assert np.abs(accelerations[:, 2]).max() < fraction * limits.angular_acceleration
        for time in (0.0, chosen.duration):
            sample = chosen.started_at((1.0, 2.0, 0.5)).sample(time)
            assert sample.pose == pytest.approx((1.0, 2.0, 0.5))
            assert sample.velocity == pytest.approx((0.0, 0.0, 0.0))


def test_a_motion_is_the_integral_of_its_velocity_and_acceleration(motion):
    moved = motion.started_at((0.3, -0.2, 1.0))
    h = 1e-5
    for time in np.linspace(0.01, motion.duration - 0.01, 23):
        before, at, after = (moved.sample(time + d) for d in (-h, 0.0, h))
        for of, rate in (("pose", "velocity"), ("velocity", "acceleration")):
            slope = np.subtract(getattr(after, of), getattr(before, of)) / (2 * h)
            np.testing.assert_allclose(slope, getattr(at, rate), atol=1e-4)


def test_an_impossible_drive_is_refused():
    with pytest.raises(InputError, match="at least 15 s"):
        choose_excitation(OMNIMAN.robot, OMNIMAN.limits, 0.35, 10.0)
    with pytest.raises(InputError, match="reach must be above 0"):
        choose_excitation(OMNIMAN.robot, OMNIMAN.limits, 0.0, 20.0)


def test_the_distance_along_the_square_is_that_in_its_own_frame():
    assert distance_along((1.0, 2.0, np.pi / 2), (0.7, 2.5, 9.0)) == pytest.approx(0.5)
    assert distance_along((1.0, 2.0, np.pi / 2), (0.4, 2.5, 9.0)) == pytest.approx(0.6)


def test_a_record_is_fitted_again_and_its_result_written(tmp_path, drive, capsys):
    check = random_excitation(OMNIMAN.robot, OMNIMAN.limits, 0.35, 20.0, 5)
    record = FloorRecord(OMNIMAN.robot, drive, prescribed_drive(TRUE, check), TRUE)
    path = tmp_path / "runs.json"
    save(record, path)
    back = load(path)
    assert back.robot == record.robot and back.truth == record.truth
    np.testing.assert_allclose(back.drive.currents, drive.currents, atol=1e-6)
    assert main(["identify", "floor", "--runs", str(path), "--results", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "Not told apart: drag.front_left, drag.front_right" in text
    written = json.loads((tmp_path / "identify_floor.json").read_text())
    assert written["ok"] and written["feed_forward"]["removed"] > 0.5
    tree = yaml.safe_load((tmp_path / "floor.yaml").read_text())
    values = flatten_mapping(tree["/**"]["ros__parameters"])
    loaded = build(Platform, {**robot_parameters("omniman"), **values})
    assert centre_of_mass(loaded)[0] == pytest.approx(centre_of_mass(TRUE)[0], rel=0.01)


@pytest.mark.exhaustive
def test_a_result_that_is_worse_on_the_check_is_not_written(tmp_path, drive, capsys):
    check = random_excitation(OMNIMAN.robot, OMNIMAN.limits, 0.35, 20.0, 5)
    record = FloorRecord(OMNIMAN.robot, drive, prescribed_drive(OMNIMAN.robot, check))
    save(record, tmp_path / "runs.json")
    arguments = ["--runs", str(tmp_path / "runs.json"), "--results", str(tmp_path)]
    assert main(["identify", "floor", *arguments]) == 1
    assert "Not identified: the feed-forward's residual" in capsys.readouterr().out
    assert not (tmp_path / "floor.yaml").exists()


def test_voltages_that_a_drive_does_not_report_survive_the_file(tmp_path, drive):
    blind = replace(drive, voltages=np.full_like(drive.voltages, np.nan))
    save(FloorRecord(OMNIMAN.robot, blind), tmp_path / "runs.json")
    assert np.isnan(load(tmp_path / "runs.json").drive.voltages).all()


def test_a_recording_becomes_a_drive_without_repeated_stamps():
    recording = Recording(times=[0.0, 0.1, 0.1, 0.3], positions=[np.full(3, k) for k in range(4)])
    recording.electrical = [(t, np.ones(3), np.zeros(3)) for t in (0.1, 0.1, 0.3)]
    found = floor_drive(recording)
    assert found.times.tolist() == [0.0, 0.1, 0.3]
    assert found.electrical_times.tolist() == [0.1, 0.3]
    recording.electrical = []
    with pytest.raises(InputError, match="wheel_electrical was not received"):
        floor_drive(recording)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-p", "body.mass:=1.0"], "are for --simulate"),
        (["--robot", "ig42"], "are for --simulate"),
        (["--duration", "5"], "not within 15 to 600"),
        (["--duration", "nan"], "not within 15 to 600"),
        (["--simulate", "--robot", "nobody"], "nobody"),
        (["--runs", "nothing.json"], "contains no recorded drives"),
    ],
)
def test_a_wrong_option_is_refused_in_one_line(arguments, message, capsys):
    assert main(["identify", "floor", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


@pytest.mark.exhaustive
@pytest.mark.processes
def test_the_command_identifies_a_simulated_robot(tmp_path):
    arguments = ("identify", "floor", "--simulate", "--duration", "30", "--results", str(tmp_path))
    with Running(command(*arguments), environment()) as running:
        assert running.process.wait(timeout=10 * PATIENCE) == 0, running.output
    written = json.loads((tmp_path / "identify_floor.json").read_text())
    mass = written["estimates"]["mass"]
    assert mass["value"] == pytest.approx(mass["truth"], rel=0.05)
    assert (tmp_path / "floor.yaml").exists()
