"""Scanners against the geometry of the scene."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters
from omniman_ros.simulation.world.scene import Post, Scene, Table, Wall
from test.simulation.world.support import ideal

from omniman_ros.simulation.world.scanner import Scanner  # isort: skip

WALL = Wall(name="wall", x=(3.0, 3.0), y=(-5.0, 5.0), thickness=0.2)
POST = Post(name="post", x=-1.5, y=1.0, radius=0.2)
FLAT = build(ScannerParameters, {"x": 0.6, "y": 0.1, "yaw": 0.3, "field_of_view": math.tau})


def test_a_longest_range_below_the_shortest_is_refused():
    with pytest.raises(ParameterError, match=r"ScannerParameters\.range_max"):
        replace(FLAT, range_min=1.0, range_max=0.5)


def scan(scene, parameters=FLAT, pose=(0.0, 0.0, 0.0), seed=0):
    bench = ideal("ig42", scene)
    bench.world.set_pose(pose)
    scanner = Scanner(bench.world, parameters, seed)
    return scanner.angles, scanner.scan()


def to_wall(angles, x):
    """Distance from x along angles to the near side of WALL."""
    with np.errstate(divide="ignore"):
        distance = (2.9 - x) / np.cos(angles)
    return np.where(distance > 0.0, distance, math.inf)


def to_post(angles, x, y):
    """Distance from (x, y) along angles to POST."""
    along = (POST.x - x) * np.cos(angles) + (POST.y - y) * np.sin(angles)
    aside = (POST.y - y) * np.cos(angles) - (POST.x - x) * np.sin(angles)
    inside = POST.radius**2 - aside**2
    hit = (inside > 0.0) & (along > 0.0)
    return np.where(hit, along - np.sqrt(np.maximum(inside, 0.0)), math.inf)


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (0.4, -0.3, 1.1)])
def test_ranges_are_those_of_the_geometry(pose):
    blind = replace(FLAT, sees_robot=False)
    angles, ranges = scan(Scene(walls=(WALL,), posts=(POST,)), blind, pose)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + c * 0.6 - s * 0.1, pose[1] + s * 0.6 + c * 0.1
    directions = angles + 0.3 + pose[2]
    expected = np.minimum(to_wall(directions, x), to_post(directions, x, y))
    ends = np.abs(y + expected * np.sin(directions)) < 4.9
    clear = (expected < 20.0) & ends
    assert clear.sum() > 200
    np.testing.assert_allclose(ranges[clear], expected[clear], atol=1e-3)
    assert np.isinf(ranges[np.isinf(expected)]).all()


def test_points_lie_on_what_the_beams_meet():
    bench = ideal("ig42", Scene(walls=(WALL,)))
    bench.world.set_pose((0.4, -0.3, 1.1))
    scanner = Scanner(bench.world, replace(FLAT, sees_robot=False))
    ranges = scanner.scan()
    points = scanner.points(ranges)
    assert len(points) == np.isfinite(ranges).sum() > 200
    on_the_side = np.abs(points[:, 1]) < 4.9
    np.testing.assert_allclose(points[on_the_side, 0], 2.9, atol=1e-3)


@pytest.mark.parametrize("name", ["omniman", "ig42"])
def test_by_default_the_robot_is_in_the_way_of_no_beam(name):
    scanner = Scanner(ideal(name).world, build(ScannerParameters, {}))
    assert np.isposinf(scanner.scan()).all()


def test_a_beam_passes_below_a_table_and_meets_its_legs():
    table = Table(name="table", x=2.0, y=0.0, length=1.0, width=1.0, height=0.7, leg=0.06)
    scanner = replace(FLAT, x=0.0, y=0.0, yaw=0.0, sees_robot=False, beams=7201)
    angles, ranges = scan(Scene(tables=(table,)), scanner)
    ahead = ranges[np.argmin(np.abs(angles))]
    leg = ranges[np.argmin(np.abs(angles - math.atan2(0.47, 1.5)))]
    assert ahead == math.inf
    assert leg == pytest.approx(math.hypot(1.5 - 0.06, 0.47) * 1.5 / 1.5, abs=0.06)
    low = replace(scanner, z=0.69)
    assert scan(Scene(tables=(table,)), low)[1][np.argmin(np.abs(angles))] == pytest.approx(1.5)


def test_the_robot_is_in_the_way_of_its_own_scanner():
    """ig42 is 0.5 m wide: a scanner 0.1 m beside it sees its side at 0.1 m."""
    beside = replace(FLAT, x=0.0, y=0.35, z=0.22, yaw=-math.pi / 2, field_of_view=0.2)
    assert scan(Scene(), beside)[1] == pytest.approx(0.1, abs=2e-3)
    assert np.isinf(scan(Scene(), replace(beside, sees_robot=False))[1]).all()


def test_noise_has_its_deviation_and_dropouts_their_rate():
    noisy = replace(FLAT, x=2.5, y=0.0, yaw=0.0, field_of_view=1.0, beams=20000)
    noisy = replace(noisy, noise=0.01, dropouts=0.1)
    angles, ranges = scan(Scene(walls=(WALL,)), noisy)
    lost = np.isinf(ranges)
    assert lost.mean() == pytest.approx(0.1, abs=0.01)
    errors = ranges[~lost] - to_wall(angles, 2.5)[~lost]
    assert errors.std() == pytest.approx(0.01, rel=0.03)
    assert errors.mean() == pytest.approx(0.0, abs=3e-4)


def test_noise_follows_the_seed():
    noisy = replace(FLAT, noise=0.01)
    scene = Scene(walls=(WALL,))
    first, again, other = (scan(scene, noisy, seed=seed)[1] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_what_is_too_near_or_too_far_is_infinite():
    near = replace(FLAT, x=2.85, y=0.0, yaw=0.0, range_min=0.1, sees_robot=False)
    angles, ranges = scan(Scene(walls=(WALL,)), near)
    assert ranges[np.argmin(np.abs(angles))] == -math.inf
    far = replace(FLAT, x=0.0, range_max=2.0, sees_robot=False)
    assert np.isinf(scan(Scene(walls=(WALL,)), far)[1]).all()


@pytest.mark.parametrize("name", ["", "2nd", "front/left", "front left", "vorne\n"])
def test_a_name_that_cannot_be_part_of_a_topic_is_refused(name):
    with pytest.raises(ParameterError, match=r"ScannerParameters\.name"):
        replace(FLAT, name=name)


def test_a_turned_scanner_measures_where_it_is_not_said_to_look():
    scene = Scene(walls=(WALL,))
    straight = replace(FLAT, yaw=0.0, y=0.0, field_of_view=1.0, beams=201)
    _, ranges = scan(scene, replace(straight, turned=0.2))
    np.testing.assert_allclose(ranges, to_wall(np.linspace(-0.5, 0.5, 201) + 0.2, 0.6), atol=1e-3)


def test_faults_begin_and_end_while_the_scanner_runs():
    bench = ideal("ig42", Scene(walls=(WALL,)))
    ahead = replace(FLAT, yaw=0.0, field_of_view=0.2, beams=3, noise=0.01)
    scanner = Scanner(bench.world, ahead, 0)
    before = scanner.scan()
    assert not np.array_equal(scanner.scan(), before)
    last = scanner.scan()
    scanner.configure(replace(ahead, fault="frozen"))
    for _ in range(3):
        np.testing.assert_array_equal(scanner.scan(), last)
    scanner.configure(replace(ahead, fault="covered"))
    np.testing.assert_array_equal(scanner.scan(), [-math.inf] * 3)
    scanner.configure(replace(ahead, fault="silent"))
    assert scanner.scan() is None
    scanner.configure(ahead)
    np.testing.assert_allclose(scanner.scan(), last, atol=0.1)


def test_the_arm_is_in_the_way_of_a_scanner_behind_it():
    """A scanner at the height of the lowered forearm sees it, and not if it sees no robot."""
    bench = ideal("omniman")
    high = replace(FLAT, x=-0.45, y=0.0, yaw=0.0, z=0.95, field_of_view=1.5)
    seen, blind = (
        Scanner(bench.world, replace(high, sees_robot=sees)).scan() for sees in (True, False)
    )
    assert np.isfinite(seen).any()
    assert np.isinf(blind).all()
