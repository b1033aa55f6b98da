import itertools
import json
import math
import os
import signal
from dataclasses import replace

import numpy as np
import pytest
import yaml

from omniman_ros.cli.main import main
from omniman_ros.console.errors import CommandError
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.odometry import OdometryParameters
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build, flatten_mapping
from omniman_ros.identification.line_reader import LineReader
from omniman_ros.identification.odometry.campaign import Accuracy, CalibrationRun
from omniman_ros.identification.odometry.command import mismatch_parameters
from omniman_ros.identification.odometry.drive_plan import (
    CORNERS,
    MARGIN,
    TARGETS,
    CalibrationMotion,
    Speeds,
    check_shape,
    displacement_to,
    max_reach,
    straight_shape,
)
from omniman_ros.identification.odometry.factor_selection import identify
from omniman_ros.identification.odometry.measured_pose import (
    TopicPoses,
    TypedPoseError,
    TypedPoses,
    describe_deviation,
    floor_pose,
    parse_pose,
)
from omniman_ros.identification.odometry.record import (
    CheckDrive,
    OdometryRecord,
    load,
    save,
    without_standstill,
)
from omniman_ros.identification.odometry.report import calibrated, faults, judge, parameter_file
from omniman_ros.identification.odometry.wheel_integration import (
    compose,
    forward_matrix,
    integrate,
)
from omniman_ros.robots import robot_parameters
from test.robots import parameters, robot
from test.running import (
    PATIENCE,
    Running,
    children_of,
    command,
    environment,
    is_alive,
    wait_until,
)

TRUE = OdometryParameters(
    scale_x=0.99, scale_y=1.015, scale_yaw=0.985, x_per_y=0.01, y_per_x=-0.005, yaw_per_x=0.02
)
PRESENT = OdometryParameters()
REACH = 0.8


# ---- typed poses ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "pose"),
    [
        ("0.853 -0.012 90", (0.853, -0.012, math.pi / 2)),
        ("  1  2\t-180 ", (1.0, 2.0, -math.pi)),
        ("1e-2; 0; 0", (0.01, 0.0, 0.0)),
        ("0 0 725", (0.0, 0.0, math.radians(725))),
        ("skip", None),
        (" SKIP ", None),
    ],
)
def test_a_pose_is_parsed(text, pose):
    parsed = parse_pose(text)
    assert parsed is None if pose is None else parsed == pytest.approx(pose)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "0 words"),
        ("1 2", "2 words"),
        ("1 2 3 4", "4 words"),
        ("a b c", "'a' is not a number"),
        ("0,85 0 90", "write a point"),
        ("0.85, 0, 90", "write a point"),
        ("853 12 90", "not millimetres"),
        ("nan 0 0", "not a finite"),
        ("0 inf 0", "not a finite"),
        ("0 0 1e9", "too much"),
        ("skipp", "1 words"),
    ],
)
def test_text_that_is_no_pose_is_refused_with_the_reason(text, why):
    with pytest.raises(TypedPoseError, match=why):
        parse_pose(text)


def test_a_pose_far_from_the_odometry_is_described():
    here = (1.0, 0.5, math.radians(179))
    assert describe_deviation((1.1, 0.4, math.radians(-179)), here) == ""
    assert "1.00 m" in describe_deviation((0.0, 0.5, here[2]), here)
    assert "90 degrees" in describe_deviation((1.0, 0.5, math.radians(89)), here)


class Typist:
    """A user who types lines into a pipe."""

    def __init__(self, *lines):
        self._read, write = os.pipe()
        with os.fdopen(write, "w") as file:
            file.write("".join(lines))
        self.waits = 0
        self.poses = TypedPoses(LineReader(self._read), self._wait)

    def _wait(self):
        self.waits += 1

    def __enter__(self):
        return self.poses

    def __exit__(self, *_):
        os.close(self._read)


def test_the_user_is_asked_until_the_input_is_a_pose(capsys):
    with Typist("hello\n", "1 2\r\n", "0.5 0.1 9\n", "next line\n") as poses:
        assert poses.start() == (0.0, 0.0, 0.0)
        measured = poses.measure("run", (0.45, 0.1, 0.15))
    assert measured == pytest.approx((0.5, 0.1, math.radians(9)))
    text = capsys.readouterr().out
    assert text.count("Where is the robot after 'run'?") == 3
    assert "2 words" in text


def test_a_pose_far_from_the_odometry_must_be_typed_twice(capsys):
    with Typist("5 0 0\n", "0.5 0 0\n") as poses:
        assert poses.measure("run", (0.5, 0.0, 0.0)) == (0.5, 0.0, 0.0)
    assert "odometry says 0.500 0.000 0.0, 4.50 m" in capsys.readouterr().out
    with Typist("5 0 0\n", "5 0 0\n") as poses:
        assert poses.measure("run", (0.5, 0.0, 0.0)) == (5.0, 0.0, 0.0)


def test_a_run_can_be_skipped():
    with Typist("skip\n") as poses:
        assert poses.measure("run", (0.5, 0.0, 0.0)) is None


def test_the_end_of_the_input_ends_the_command():
    with Typist("0.5 0") as poses, pytest.raises(CommandError, match="the input has ended"):
        poses.measure("run", (0.5, 0.0, 0.0))


def test_ros_is_served_while_the_user_types():
    """The line arrives in pieces, one in each round of serving ROS."""
    read, write = os.pipe()
    pieces = iter([b"0.5", b"", b" 0 ", b"0\n1 1"])
    lines = LineReader(read)
    assert lines.next(lambda: os.write(write, next(pieces))) == "0.5 0 0"
    assert next(pieces, None) is None
    os.close(write)
    os.close(read)


# ---- poses from a topic ------------------------------------------------------------------------


def test_poses_of_a_topic_are_relative_to_the_start():
    seen = iter([(3.0, 1.0, math.pi / 2), (2.0, 3.0, -math.pi)])
    poses = TopicPoses("mocap", lambda: next(seen))
    assert poses.start() == (0.0, 0.0, 0.0)
    assert poses.measure("run", (0, 0, 0)) == pytest.approx((2.0, 1.0, math.pi / 2))


def test_a_silent_topic_is_an_error():
    with pytest.raises(CommandError, match="nothing received on 'mocap'"):
        TopicPoses("mocap", lambda: None).start()


def test_floor_pose_undoes_the_origin():
    rng = np.random.default_rng(1)
    for _ in range(10):
        origin, pose = rng.uniform(-3, 3, (2, 3))
        back = compose(origin, np.array(floor_pose(tuple(origin), tuple(pose))))
        np.testing.assert_allclose(back[:2], pose[:2], atol=1e-12)
        assert math.remainder(back[2] - pose[2], math.tau) == pytest.approx(0.0, abs=1e-12)


# ---- the plan ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["omniman", "ig42"])
@pytest.mark.parametrize("area", [2.4, 3.0, 5.0])
def test_all_runs_stay_within_the_square_and_the_limits(name, area):
    made = parameters(name)
    reach = max_reach(area, made.robot.body)
    corner = 0.5 * math.hypot(made.robot.body.length, made.robot.body.width)
    assert (1 + MARGIN) * reach + corner == pytest.approx(area / 2)
    speeds = Speeds.within(made.limits, 0.4)
    here, heading = (0.0, 0.0, 0.0), 0.0
    motions = []
    for target in TARGETS:
        for way in (displacement_to(here, heading, target.corner, reach), (0.0, 0.0, target.turn)):
            motions.append(CalibrationMotion(straight_shape(way), here, speeds))
            here = motions[-1].sample(math.inf).pose
        heading += target.turn
        assert here == pytest.approx((*(reach * c for c in CORNERS[target.corner]), heading))
    assert here == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    motions.append(CalibrationMotion(check_shape(reach), here, speeds))
    for motion in motions:
        samples = [motion.sample(t) for t in np.linspace(0, motion.duration, 200)]
        for sample in samples:
            assert max(map(abs, sample.pose[:2])) <= reach + 1e-9
            assert math.hypot(*sample.velocity[:2]) <= 0.4 + 1e-3
            assert abs(sample.velocity[2]) <= speeds.angular + 1e-3
            limits = made.limits
            assert math.hypot(*sample.acceleration[:2]) <= limits.linear_acceleration
            assert abs(sample.acceleration[2]) <= limits.angular_acceleration
        assert samples[0].velocity == samples[-1].velocity == (0.0, 0.0, 0.0)


def test_a_motion_is_the_integral_of_its_velocity_and_acceleration():
    motion = CalibrationMotion(check_shape(0.7), (0.3, -0.2, 1.0), Speeds(0.4, 0.8, 1.0))
    h = 1e-5
    for time in np.linspace(0.01, motion.duration - 0.01, 37):
        before, at, after = (motion.sample(time + d) for d in (-h, 0.0, h))
        for of, rate in (("pose", "velocity"), ("velocity", "acceleration")):
            slope = np.subtract(getattr(after, of), getattr(before, of)) / (2 * h)
            np.testing.assert_allclose(slope, getattr(at, rate), atol=1e-4)


def test_the_plan_determines_all_factors_with_a_tape_measure():
    """In the default square the intervals are far below the errors to calibrate."""
    found = identify(driven(TRUE).campaign, PRESENT)
    assert not found.undetermined
    assert found.model == "twist"
    assert max(factor.half_width for factor in found.factors) < 0.006


def test_a_deviation_at_the_start_of_a_run_is_corrected_on_the_way():
    here = (0.1, -0.05, math.pi + 0.05)
    way = displacement_to(here, math.pi, "front left", 1.0)
    end = CalibrationMotion(straight_shape(way), here, Speeds(0.3, 0.6, 1.0)).sample(math.inf).pose
    assert end == pytest.approx((1.0, 1.0, math.pi))


def test_a_square_that_is_too_small_is_refused_with_the_smallest():
    with pytest.raises(CommandError, match=r"at least 1\.8") as refusal:
        max_reach(1.5, robot("omniman").body)
    assert refusal.value.code == 2
    assert max_reach(1.8, robot("omniman").body) > 0.25


@pytest.mark.parametrize("speed", [0.0, -1.0, 0.71, math.nan])
def test_a_speed_beyond_the_limits_is_refused(speed):
    with pytest.raises(CommandError, match=r"0\.7 m/s") as refusal:
        Speeds.within(parameters("omniman").limits, speed)
    assert refusal.value.code == 2


# ---- record ------------------------------------------------------------------------------------


def driven(true, check_end=True, noise=0.0):
    """Return a record of the whole plan on a robot whose odometry is exact with `true`.

    The wheels turn as configured.
    """
    wheels = robot().wheels
    model = PlatformKinematics(wheels)
    forward = forward_matrix(wheels, true)
    speeds = Speeds(0.4, 0.8, 1.0)
    rng = np.random.default_rng(3)

    def turned(motion):
        times = np.arange(0.0, motion.duration + 0.02, 0.02)
        poses = np.array([motion.sample(t).pose for t in times])
        steps = []
        for a, b in itertools.pairwise(poses):
            middle = 0.5 * (a[2] + b[2])
            c, s = math.cos(middle), math.sin(middle)
            dx, dy, turn = b - a
            steps.append(model.J @ [c * dx + s * dy, -s * dx + c * dy, turn])
        return times, np.vstack([np.zeros(4), np.cumsum(steps, axis=0)])

    pose = (0.0, 0.0, 0.0)
    record = OdometryRecord(wheels, PRESENT, Accuracy(), poses=(pose,))
    here, heading = pose, 0.0
    for number, target in enumerate(TARGETS):
        parts = []
        for way in (displacement_to(here, heading, target.corner, REACH), (0.0, 0.0, target.turn)):
            motion = CalibrationMotion(straight_shape(way), here, speeds)
            parts.append(turned(motion)[1])
            here = motion.sample(math.inf).pose
        heading += target.turn
        positions = np.vstack([parts[0], parts[0][-1] + parts[1][1:]])
        pose = tuple(integrate(forward, positions, pose)[-1].tolist())
        measured = tuple((np.array(pose) + noise * rng.normal(size=3)).tolist())
        record = record.with_run(CalibrationRun(f"{number}", positions), measured)
    times, positions = turned(CalibrationMotion(check_shape(REACH), here, speeds))
    poses = integrate(forward, positions, record.poses[-1])
    truth = np.column_stack([times, poses])[::3]
    end = tuple(poses[-1].tolist()) if check_end else None
    return replace(record, check=CheckDrive(times, positions, record.poses[-1], end, truth))


def test_a_record_is_read_as_it_was_written(tmp_path):
    record = driven(TRUE)
    record = replace(record, poses=(*record.poses[:3], None, *record.poses[4:]))
    save(record, tmp_path / "deep" / "runs.json")
    back = load(tmp_path / "deep" / "runs.json")
    assert back.wheels == record.wheels
    assert back.odometry == record.odometry
    assert back.accuracy == record.accuracy
    assert back.poses == record.poses
    assert [run.name for run in back.runs] == [run.name for run in record.runs]
    np.testing.assert_allclose(back.runs[3].positions, record.runs[3].positions, atol=1e-7)
    np.testing.assert_allclose(back.check.truth, record.check.truth, atol=1e-7)
    assert back.check.end == record.check.end
    nothing = replace(record, check=None)
    save(nothing, tmp_path / "runs.json")
    assert load(tmp_path / "runs.json").check is None


@pytest.mark.parametrize(
    "text",
    [None, "", "{}", "[1]", '{"format": "other"}', '{"format": "omniman odometry runs 1"}'],
)
def test_a_file_that_is_no_record_is_refused(tmp_path, text, capsys):
    path = tmp_path / "runs.json"
    if text is not None:
        path.write_text(text)
    assert main(["identify", "odometry", "--runs", str(path), "--results", str(tmp_path)]) == 2
    assert "contains no recorded runs" in capsys.readouterr().err


def test_rows_without_motion_are_removed():
    positions = np.array([[0.0, 0], [0, 0], [0, 1], [0, 1], [0, 1]])
    times, kept = without_standstill(np.arange(5.0), positions)
    np.testing.assert_array_equal(times, [0, 2, 4])
    np.testing.assert_array_equal(kept, [[0, 0], [0, 1], [0, 1]])


# ---- result ------------------------------------------------------------------------------------


def test_recorded_runs_are_fitted_and_written(tmp_path, capsys):
    path = tmp_path / "runs.json"
    save(driven(TRUE), path)
    assert main(["identify", "odometry", "--runs", str(path), "--results", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    result = json.loads(lines[-1])
    assert result == json.loads((tmp_path / "identify_odometry.json").read_text())
    assert result["ok"] is True
    assert result["parameters"]["odometry.scale_y"] == pytest.approx(1.015, abs=1e-4)
    assert result["check"]["removed"] > 0.998
    assert result["check"]["before"]["end_mm"] > 5.0
    assert any("100 % of the error is removed" in line for line in lines)
    tree = yaml.safe_load((tmp_path / "odometry.yaml").read_text())
    values = flatten_mapping(tree["/**"]["ros__parameters"])
    loaded = build(OdometryParameters, values, "odometry.")
    assert set(values) == {f"odometry.{name}" for name in calibrated(identified())}
    np.testing.assert_allclose(loaded.correction, TRUE.correction, atol=1e-6)


def identified():
    record = driven(TRUE)
    return identify(record.campaign, record.odometry)


def test_the_parameter_file_contains_every_factor_so_that_none_remains_from_before():
    tree = yaml.safe_load(parameter_file(identified()))
    names = set(tree["/**"]["ros__parameters"]["odometry"])
    scales = {"scale_x", "scale_y", "scale_yaw", "wheel_scale"}
    assert names == scales | {
        "x_per_y",
        "x_per_yaw",
        "y_per_x",
        "y_per_yaw",
        "yaw_per_x",
        "yaw_per_y",
    }
    for value in tree["/**"]["ros__parameters"]["odometry"].values():
        assert all(isinstance(item, float) for item in np.ravel(value).tolist())


def test_a_check_that_got_worse_fails_and_writes_no_parameter_file(tmp_path, capsys):
    record = driven(TRUE)
    other = driven(PRESENT).check  # the check of a robot whose odometry was exact before
    path = tmp_path / "runs.json"
    save(replace(record, check=other), path)
    assert main(["identify", "odometry", "--runs", str(path), "--results", str(tmp_path)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert any("Not calibrated: the error on the check path grew from" in line for line in lines)
    assert json.loads(lines[-1])["ok"] is False
    assert not (tmp_path / "odometry.yaml").exists()


def test_without_a_measured_end_there_is_no_check():
    record = driven(TRUE, check_end=False)
    record = replace(record, check=replace(record.check, truth=np.zeros((0, 4))))
    calibration = identify(record.campaign, record.odometry)
    assert judge(record, calibration) == {}
    assert faults(record, {}) == []
    only_end = replace(driven(TRUE), check=replace(driven(TRUE).check, truth=np.zeros((0, 4))))
    assert judge(only_end, calibration)["removed_of"] == "end_mm"


def test_the_stated_accuracy_can_be_changed_afterwards(tmp_path, capsys):
    path = tmp_path / "runs.json"
    save(driven(TRUE), path)
    arguments = ["identify", "odometry", "--runs", str(path), "--results", str(tmp_path)]
    assert main([*arguments, "--accuracy", "1.5", "0.15"]) == 0
    half = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert main(arguments) == 0
    whole = json.loads(capsys.readouterr().out.splitlines()[-1])
    for a, b in zip(half["factors"], whole["factors"], strict=True):
        assert a["half_width"] == pytest.approx(b["half_width"] / 2, rel=0.02)


def test_too_few_poses_are_an_error():
    record = driven(TRUE)
    with pytest.raises(InputError, match="fewer than two"):
        _ = replace(record, poses=(record.poses[0], *[None] * len(TARGETS))).campaign


# ---- command line ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-p", "mismatch.radius:=[1.0]"], "are for --simulate"),
        (["--robot", "ig42"], "are for --simulate"),
        (["--accuracy", "0", "1"], "must be above 0"),
        (["--accuracy", "nan", "1"], "must be above 0"),
        (["--simulate", "--robot", "nobody"], "nobody"),
        (["--simulate", "-p", "drive.mode=torque"], "is not NAME:=VALUE"),
    ],
)
def test_a_wrong_option_is_refused_in_one_line(arguments, message, capsys):
    assert main(["identify", "odometry", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


@pytest.mark.parametrize("arguments", [[], ["friends"], ["odometry", "--area", "big"]])
def test_a_wrong_subject_is_exit_code_2(arguments, capsys):
    with pytest.raises(SystemExit) as end:
        main(["identify", *arguments])
    assert end.value.code == 2
    assert "usage: omniman identify" in capsys.readouterr().err


def test_the_simulated_robot_differs_in_every_way_that_is_calibrated():
    names = {text.partition(":=")[0] for text in mismatch_parameters("omniman")}
    assert names == {
        "mismatch.radius",
        "mismatch.offset_x",
        "mismatch.offset_y",
        "mismatch.heading",
    }
    assert not names & set(robot_parameters("omniman"))


@pytest.mark.processes
def test_ctrl_c_stops_the_robot_and_ends_with_130(tmp_path):
    arguments = ("identify", "odometry", "--simulate", "--results", str(tmp_path))
    with Running(command(*arguments), environment()) as running:
        running.wait_for("the robot is running")
        pids = children_of(running.process.pid)
        assert len(pids) == 2
        running.process.send_signal(signal.SIGINT)
        assert running.process.wait(timeout=PATIENCE) == 130
        wait_until(lambda: not any(map(is_alive, pids)), "the end of the nodes")
    assert not list(tmp_path.iterdir()), "no run was driven, so none is kept"
