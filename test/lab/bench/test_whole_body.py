import json
import math
import subprocess
import sys

import numpy as np
import pytest

from omniman_ros.cli.main import main
from omniman_ros.core.arm_model import ArmModel
from omniman_ros.core.parameters import build
from omniman_ros.lab.bench import whole_body as bench
from omniman_ros.lab.bench import whole_body_inverse as inverse
from omniman_ros.lab.bench import whole_body_stream as stream
from omniman_ros.lab.studies.tool_courses import COURSES, start
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.model import planar_transform
from omniman_ros.nodes.trajectory_interfaces.parameters import PathInterpolatorParameters
from omniman_ros.robots import load_robot
from test.running import command, environment

PARAMETERS = build(PathInterpolatorParameters, load_robot("omniman"))
BENCH = bench.PlanningBench(PARAMETERS)
ARM = ArmModel()
BENT = np.array([0.3, -1.1, 1.4, -0.9, 0.8, 0.2])


@pytest.fixture(scope="module")
def short():
    """Return the poses of a short path and their plan."""
    poses = bench.course_poses(BENCH.model, "S", 0.5, 20)
    return poses, BENCH.plan(poses)


@pytest.mark.parametrize("name", COURSES)
def test_paths_have_the_stated_number_of_poses_and_begin_at_the_tool(name):
    poses = bench.course_poses(BENCH.model, name, 12.0, 1000)
    assert poses.shape == (1000, 4, 4)
    assert poses[0] == pytest.approx(BENCH.model.forward(start()))
    steps = np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1)
    assert steps == pytest.approx(12.0 / 999, rel=1e-3)


def test_tool_turns_with_its_direction_of_travel_on_the_circle():
    poses = bench.course_poses(BENCH.model, "circle", 4.0, 2000)
    way = np.diff(poses[:, :2, 3], axis=0)
    seen = np.einsum("kji,kj->ki", poses[:-1, :2, :3], way) / np.linalg.norm(way, axis=1)[:, None]
    assert np.ptp(seen, axis=0).max() < 2e-3
    turned = poses[-1, :3, :3] @ poses[0, :3, :3].T
    assert math.acos(0.5 * (np.trace(turned) - 1.0)) > 1.0


def test_plain_resampling_is_at_constant_speed_with_the_tool_on_its_path():
    poses = bench.course_poses(BENCH.model, "straight", 2.0, 50)
    tool = BENCH.model.forward(bench.resampled(BENCH.model, poses, 0.2))
    assert np.diff(tool[:, 0, 3]) == pytest.approx(0.2 * TICK)
    assert tool[:, 1:3, 3] == pytest.approx(np.tile(poses[0, 1:3, 3], (len(tool), 1)))
    assert tool[0] == pytest.approx(poses[0])


def test_plan_is_timed_by_parts_and_against_plain_resampling(short):
    figures = BENCH.figures(short[0], 1)
    parts = figures["parts_ms"]
    assert set(parts) == {"curve", "postures", "timing", "checks"}
    assert min(parts[name] for name in ("curve", "postures", "timing")) > 0.0
    assert figures["planning_ms"] > figures["plain_resampling_ms"] > 0.0
    assert figures["duration_s"] == pytest.approx(short[1].curve.duration)
    assert figures["duration_ratio"] == pytest.approx(
        short[1].curve.duration * PARAMETERS.tool_path.linear_velocity / short[1].length
    )
    assert figures["duration_ratio"] > 1.0


def test_plan_stays_within_the_limits_and_the_limiting_axis_is_named(short):
    plan = short[1]
    used = bench.limits_used(plan, BENCH.limits)
    assert set(used) == {"velocity", "acceleration", "jerk"}
    assert all(0.05 < most["share"] <= 1.0 for most in used.values())
    assert all(most["axis"] in ("odom_xy", *BENCH.limits.names) for most in used.values())
    speed = np.hypot(*plan.curve.velocities[:, :2].T).max() / BENCH.limits.velocity[0]
    joints = np.abs(plan.curve.velocities[:, 2:]) / BENCH.limits.velocity[2:]
    assert used["velocity"]["share"] == pytest.approx(max(speed, joints.max()))


def test_manipulability_and_reach_are_of_the_worst_instant(short):
    plan = short[1]
    figures = bench.quality(plan, BENCH.model)
    q = plan.curve.positions
    jacobians = BENCH.model.jacobian(q)[:, :, 3:]
    # A rotation of the base changes neither determinant nor distance.
    assert figures["least_manipulability"] == pytest.approx(
        np.abs(np.linalg.det(jacobians)).min(), rel=1e-9
    )
    tool = BENCH.model.forward(q)[:, :3, 3]
    base = (planar_transform(q[:, :3]) @ PARAMETERS.mount.pose)[:, :3, 3]
    away = np.linalg.norm(tool - base, axis=1)
    assert figures["largest_reach_m"] == pytest.approx(away.max())
    assert figures["first_reach_m"] == pytest.approx(away[0])
    assert 0.0 < figures["least_manipulability"] <= figures["first_manipulability"]


@pytest.mark.parametrize("platform", [False, True])
def test_measured_preview_corrects_the_error_of_the_platform(short, platform):
    bare = stream.BareStream(PARAMETERS, short[1])
    at = 0.5 * short[1].curve.duration
    horizon = PARAMETERS.horizon if platform else stream.MIN_CORRECTION_PERIOD
    plain, _ = bare.window(at, horizon)
    assert plain.positions == pytest.approx(bare.planned(at, horizon))
    for _ in range(20):
        bare.update_odom()
    window, tool = bare.window(at, horizon)
    assert window.positions[:, :3] == pytest.approx(plain.positions[:, :3])
    assert np.abs(window.positions[0, 3:] - plain.positions[0, 3:]).max() > 1e-3
    real = window.positions[0] + np.concatenate([stream.PLATFORM_ERROR, np.zeros(6)])
    assert BENCH.model.forward(real) == pytest.approx(tool, abs=1e-6)
    bare.fill_messages(at, horizon, platform)
    message = bare._both if platform else bare._arm
    assert len(message.points) == len(window.times)
    assert list(message.points[-1].positions) == pytest.approx(window.positions[-1, 3:])


@pytest.mark.processes
def test_previews_are_measured_with_the_previews_of_the_node(short, own_domain):
    figures = stream.measure_previews(PARAMETERS, "omniman", short[1], 1)
    kinds = {"planned", "corrected", "and_filled", "and_published"}
    for name in ("arm", "both"):
        assert set(figures[name]) == kinds
        assert all(0.0 < value < 1e5 for value in figures[name].values())
    tick, both, arm = figures["tick"], figures["both"], figures["arm"]
    # 25 previews of both, 25 of the arm and 100 poses of odom in 125 ticks.
    for kind in tick:
        expected = (25 * both[kind] + 25 * arm[kind] + 100 * figures["receive_odom"]) / 125
        assert tick[kind] == pytest.approx(expected)


@pytest.mark.processes
def test_node_that_aborts_raises_an_error(short, own_domain, monkeypatch):
    def lost(self, platform, times):
        return platform + np.array([3.0, 0.0, 0.0])

    monkeypatch.setattr(
        "omniman_ros.motion.whole_body.correction.PlatformCorrection.platform_at", lost
    )
    with pytest.raises(stream.CommandError, match="the node aborted the path"):
        stream._measure_published("omniman", PARAMETERS, short[1], lambda work: work(0.0) or 1.0)


@pytest.mark.parametrize("turn", [1e-9, 0.3, 2.0, 3.1])
def test_pose_error_is_a_translation_and_a_rotation_vector(turn):
    here = ARM.forward(BENT)
    goal = here.copy()
    goal[:3, 3] += [0.1, -0.2, 0.3]
    goal[:3, :3] = planar_transform(np.array([0.0, 0.0, turn]))[:3, :3] @ here[:3, :3]
    assert inverse.pose_error(here, goal) == pytest.approx(
        [0.1, -0.2, 0.3, 0.0, 0.0, turn], rel=1e-6
    )


def test_newton_finds_near_solutions_and_reports_failure():
    newton = inverse.Newton(ARM)
    found, rounds = newton(ARM.forward(BENT), BENT + 0.1, 1e-9)
    assert found == pytest.approx(BENT, abs=1e-7) and 2 <= rounds <= 8
    far = np.eye(4)
    far[:3, 3] = 2.0, 0.0, 0.0
    assert newton(far, BENT, 1e-9)[1] == -1


def test_failures_of_an_iteration_count_as_time_but_not_as_solutions(monkeypatch):
    sample = inverse.Sample.draw(ARM, 8)
    clock = iter(np.arange(100.0))
    monkeypatch.setattr(inverse.time, "process_time", lambda: next(clock))
    calls = []

    def solve(pose, start, tolerance):
        calls.append(tolerance)
        return start, 7 if len(calls) % 4 else -1

    rows = inverse.measure_iteration(solve, sample, 8)
    assert set(rows) == {"near 0.0001", "near 1e-09", "neutral 0.0001", "neutral 1e-09"}
    for row in rows.values():
        assert row == {"per_second": 6.0, "success": 0.75, "iterations": 7.0}
    assert inverse.ratios({"1": 12.0}, 6.0) == {"1": 2.0}
    assert inverse.ratios({"1": 12.0}, 0.0) == {"1": None}


def test_closed_form_is_exact_on_all_poses():
    figures = inverse.measure_closed_form(ARM, inverse.Sample.draw(ARM, 300), 0.0)
    assert figures["success"] == 1.0 and figures["poses"] == 300
    assert figures["worst_pose_error"] < 1e-9 and figures["worst_angle_error"] < 1e-7
    assert figures["one_branch"]["1"] > figures["all_eight"]["1"] > 0.0


def test_benchmark_runs_without_pin(monkeypatch):
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    monkeypatch.setattr(inverse, "BATCHES", (1, 20))
    p = PARAMETERS
    result = inverse.measure(p.core.robot, p.arm, p.mount, 3, 0.0)
    assert result["pin"] is None and set(result["iterations"]) == {"Newton in numpy"}
    lines = inverse.rows(result)
    assert lines[-1][:2] == ("pin", "not installed")


def test_pin_agrees_on_the_description_of_the_robot():
    pin = pytest.importorskip("pinocchio")
    arm = inverse.PinArm(pin, PARAMETERS.core.robot, PARAMETERS.arm, PARAMETERS.mount)
    sample = inverse.Sample.draw(ARM, 100)
    assert max(arm.difference(sample.angles, BENCH.model).values()) < 1e-9
    for step in inverse.STEPS.values():
        found, _ = inverse.PinIteration(arm, step)(ARM.forward(BENT), BENT + 0.1, 1e-9)
        assert found == pytest.approx(BENT, abs=1e-7)


@pytest.mark.parametrize("robot", ["nobody", "/nowhere/robot.yaml"])
def test_unknown_robot_is_refused(robot, capsys):
    assert main(["bench", "whole_body", "--robot", robot]) == 2
    assert f"robot '{robot}'" in capsys.readouterr().err


@pytest.mark.exhaustive
@pytest.mark.processes
def test_benchmark_runs_end_to_end_and_publishes_its_json(tmp_path):
    ended = subprocess.run(
        command("bench", "whole_body", "--quick", "--results", str(tmp_path)),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    result = json.loads(ended.stdout.splitlines()[-1])
    assert result == json.loads((tmp_path / "bench_whole_body.json").read_text())
    assert set(result["planning"]) == {"circle 100", "circle 10000"}
    numbers = [value for value in leaves(result) if not isinstance(value, str | bool)]
    assert len(numbers) > 60
    assert all(number is not None and math.isfinite(number) for number in numbers)
    for name, row in result["planning"].items():
        assert 1.0 < row["duration_ratio"] < 1.2
        # The printed value is rounded once, the JSON value beforehand.
        printed = {f"{row['planning_ms'] + by:.0f} ms" for by in (-0.1, 0.1)}
        assert any(text in ended.stdout for text in printed), name
    share = result["cpu_share"]
    assert share["cpu_per_tick_us"] == pytest.approx(
        8000 * share["driving"]["path_interpolator"], rel=1e-3
    )
    assert min(*share["idle"].values(), *share["driving"].values()) > 0.0
    assert 1.0 < share["previews_per_s"] < 100.0
    assert "Newton in numpy, 0.1 rad away, to 1e-09" in ended.stdout


def leaves(tree):
    """Return all values of a result except those of pin, which may be missing."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from leaves(value)
        elif key != "pin":
            yield value
