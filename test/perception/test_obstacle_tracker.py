"""Tracks of discs whose scans are computed by the test."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.errors import InputError
from omniman_ros.perception.obstacle_tracker import ObstacleTracker
from omniman_ros.perception.parameters import MapParameters, TrackerParameters
from omniman_ros.perception.scan import Scan
from omniman_ros.surroundings.tracking import TrackingParameters

BEAMS = 720
ANGLES = np.linspace(-0.5 * math.pi, 0.5 * math.pi, BEAMS)
OWN = Footprint(Rectangles.centred(np.array([0.2, 0.15])), (0.0, 0.4))
NOISE = 0.005


def ranges_of(discs, origin, heading, wall=4.5):
    """Ranges of beams in the directions heading + ANGLES, each from its own place and heading."""
    ux, uy = np.cos(ANGLES + heading), np.sin(ANGLES + heading)
    x, y = np.asarray(origin).T
    found = np.where(ux > 1e-9, (wall - x) / np.where(ux > 1e-9, ux, 1.0), math.inf)
    for position, radius in discs:
        position = np.asarray(position)
        ax, ay = (
            (position.T - np.array([x, y]))
            if position.ndim == 2
            else (position[0] - x, position[1] - y)
        )
        along, aside = ax * ux + ay * uy, ax * uy - ay * ux
        inside = radius**2 - aside**2
        hit = np.where(inside > 0.0, along - np.sqrt(np.maximum(inside, 0.0)), math.inf)
        found = np.where((hit > 0.0) & (hit < found), hit, found)
    return np.where(found < 15.0, found, math.inf)


class Stage:
    """A tracker in the middle of discs that move; the robot drives on an arc."""

    def __init__(self, twist=(0.0, 0.0, 0.0), sweep=0.0, **parameters):
        self.tracker = ObstacleTracker(
            TrackerParameters(**parameters), MapParameters(), TrackingParameters()
        )
        self.twist, self.sweep, self.now = np.array(twist), sweep, 0.0
        self.rng = np.random.default_rng(0)
        self.fine = np.arange(-0.2, 30.0, 0.002)
        theta = self.twist[2] * self.fine
        vx, vy = self.twist[:2]
        c, s = np.cos(theta), np.sin(theta)
        self.path = np.column_stack(
            (
                np.cumsum(0.002 * (c * vx - s * vy)),
                np.cumsum(0.002 * (s * vx + c * vy)),
                theta,
            )
        )

    def pose(self, times):
        return np.column_stack([np.interp(times, self.fine, axis) for axis in self.path.T])

    def run(self, seconds, discs):
        """Scan 20 times a second; `discs` maps times (N,) to pairs of places and radii."""
        for _ in range(round(seconds / 0.05)):
            for k in range(6):
                at = self.now - 0.01 + 0.01 * k
                before, after = self.pose(np.array([at, at + 1e-3]))
                self.tracker.add_pose(at, before, (after - before) / 1e-3)
            times = self.now + self.sweep / BEAMS * np.arange(BEAMS)
            poses = self.pose(times)
            ranges = ranges_of(discs(times), poses[:, :2], poses[:, 2])
            ranges = ranges + self.rng.normal(0.0, NOISE, BEAMS)
            scan = Scan(
                self.now,
                ranges,
                -0.5 * math.pi,
                math.pi / (BEAMS - 1),
                15.0,
                (0.0, 0.0, 0.0),
                self.sweep / BEAMS,
                (0.2, 0.2),
            )
            self.tracker.add_scan(scan, OWN)
            self.end = scan.end
            self.now += 0.05
        return self.tracker.obstacles(self.end)


def line(x, y, vx, vy, radius=0.25):
    return lambda times: [(np.column_stack((x + vx * times, y + vy * times)), radius)]


@pytest.mark.parametrize("velocity", [(0.0, 1.0), (-1.0, 0.2), (0.6, 0.6), (1.0, 0.0)])
def test_velocity_and_place_are_right_half_a_second_after_the_first_sight(velocity):
    stage = Stage()
    (seen,) = stage.run(0.6, line(2.2, -0.3, *velocity))
    assert np.hypot(*np.subtract(seen.velocity, velocity)) < 0.1
    position = np.array([2.2, -0.3]) + stage.end * np.array(velocity)
    assert np.hypot(*(np.array(seen.center) - position)) < 0.03
    assert seen.radius == pytest.approx(0.25, abs=0.03)
    assert seen.age == pytest.approx(0.55)
    assert seen.silence == 0.0


POSTS = [(np.array(position), 0.1) for position in ((2.0, -0.5), (1.5, 1.5), (3.0, 2.5))]


def misplaced(tracker):
    """Largest distance of a standing cell from what truly stands [m]."""
    rows, columns = np.nonzero(tracker.map.log_odds >= 1.6)
    positions = tracker.map.origin + tracker.map.resolution * (
        np.column_stack((columns, rows)) + 0.5
    )
    off = [np.abs(np.hypot(*(positions - position).T) - radius) for position, radius in POSTS]
    assert len(positions) > 50
    return float(np.min([*off, np.abs(positions[:, 0] - 4.5)], axis=0).max())


@pytest.mark.parametrize("sweep", [0.0, 0.04])
def test_the_motion_of_robot_and_beam_moves_nothing_that_stands(sweep):
    stage = Stage(twist=(0.5, 0.2, 0.9), sweep=sweep)
    for _ in range(10):
        assert stage.run(0.15, lambda times: POSTS) == []
    assert misplaced(stage.tracker) < 0.08


def test_without_the_times_of_its_beams_a_scan_is_misplaced():
    """The counter-example to the test above: it could fail."""
    stage = Stage(twist=(0.5, 0.2, 0.9), sweep=0.04)
    add = stage.tracker.add_scan
    stage.tracker.add_scan = lambda scan, own: add(replace(scan, beam_time=0.0), own)
    stage.run(1.5, lambda times: POSTS)
    assert misplaced(stage.tracker) > 0.1


def test_two_who_cross_keep_their_identities():
    def walkers(times):
        return [
            (np.column_stack((np.full(BEAMS, 1.6), -1.2 + 1.0 * times)), 0.25),
            (np.column_stack((np.full(BEAMS, 2.6), 1.6 - 1.0 * times)), 0.25),
        ]

    stage = Stage()
    before = {round(o.center[0], 1): o.number for o in stage.run(0.8, walkers)}
    hidden = False
    for _ in range(10):
        hidden |= any(o.silence > 0.0 for o in stage.run(0.15, walkers))
    after = {round(o.center[0], 1): o.number for o in stage.run(0.1, walkers)}
    assert set(before) == {1.6, 2.6}
    assert after == before
    assert hidden, "the one behind was not hidden"


def test_two_who_come_near_each_other_stay_two():
    def walkers(times):
        return [
            (np.column_stack((np.full(BEAMS, 2.2), -1.2 + 0.8 * times)), 0.25),
            (np.column_stack((np.full(BEAMS, 2.2), 0.55 - 0.4 * times)), 0.25),
        ]

    stage = Stage()
    found = sorted(o.center[1] for o in stage.run(1.0, walkers))
    assert found == pytest.approx([-1.2 + 0.8 * stage.end, 0.55 - 0.4 * stage.end], abs=0.05)


def test_who_stays_behind_something_is_forgotten_in_the_end():
    stage = Stage(occlusion_time=1.0)
    wall = [(np.array((1.5, 1.0)), 0.6)]
    walks, stands = line(2.6, -1.0, 0.0, 1.2), line(2.6, 1.3, 0.0, 0.0)
    (seen,) = stage.run(1.0, lambda t: walks(t) + wall)
    stage.run(0.9, lambda t: walks(t) + wall)
    (hidden,) = stage.run(0.3, lambda t: stands(t) + wall)
    assert hidden.number == seen.number
    assert hidden.silence > 0.2
    assert stage.run(1.2, lambda t: stands(t) + wall) == []


def test_who_vanishes_in_plain_sight_is_gone_at_once():
    stage = Stage()
    assert len(stage.run(1.0, line(2.0, -0.5, 0.0, 1.0))) == 1
    assert stage.run(0.25, lambda times: []) == []


def test_who_rests_belongs_to_the_map_after_a_while():
    stage = Stage(rest_time=1.0)
    assert len(stage.run(1.0, line(2.0, -0.5, 0.0, 1.0))) == 1
    rest = line(2.0, 0.5, 0.0, 0.0)
    (seen,) = stage.run(0.8, rest)
    assert math.hypot(*seen.velocity) < 0.1
    assert not stage.tracker.map.stands(np.array([[1.75, 0.5]])).any()
    assert stage.run(1.5, rest) == []
    assert stage.tracker.map.stands(np.array([[1.75, 0.5]])).all()


def test_the_part_of_a_wall_that_shows_behind_somebody_does_not_move():
    stage = Stage()
    for k in range(20):
        reported = stage.run(0.1, line(3.2, -1.5, 0.0, 1.5, 0.3))
        assert len(reported) <= 1, k
        assert all(abs(o.center[0] - 3.2) < 0.2 for o in reported)


def test_points_on_the_robot_itself_are_not_there():
    stage = Stage()
    mine = [(np.array((0.12, 0.05)), 0.03)]
    stage.run(0.5, lambda times: mine)
    assert stage.tracker.count == 0
    assert not stage.tracker.map.stands(np.array([[0.1, 0.05]])).any()


def test_the_same_scans_give_the_same_tracks_to_the_last_bit():
    def drive():
        stage = Stage(twist=(0.3, 0.0, 0.2), sweep=0.03)
        return stage.run(1.0, line(2.0, -1.0, 0.1, 1.0)), stage.tracker.occupancy()

    (first, one), (second, other) = drive(), drive()
    assert first == second
    assert first
    np.testing.assert_array_equal(one, other)


def test_a_scan_without_odometry_changes_nothing():
    stage = Stage()
    stage.run(0.3, line(2.0, -1.0, 0.0, 1.0))
    late = Scan(5.0, np.ones(10), 0.0, 0.1, 5.0, (0.0, 0.0, 0.0))
    before, time = stage.tracker.occupancy(), stage.tracker.time
    with pytest.raises(InputError, match="odometry ends"):
        stage.tracker.add_scan(late, OWN)
    np.testing.assert_array_equal(stage.tracker.occupancy(), before)
    assert stage.tracker.time == time


def test_a_scan_from_before_a_jump_of_the_odometry_is_not_entered_after_it():
    stage = Stage()
    stage.run(0.5, lambda times: POSTS)
    standing = stage.tracker.map.standing
    assert len(standing())
    # The odometry is set first; the robot follows, and for one more scan it is where it was.
    stage.path = stage.path + [3.0, 0.0, 0.0]
    stage.tracker.add_pose(stage.now - 0.005, np.array([3.0, 0.0, 0.0]), np.zeros(3))
    assert not len(standing())
    stage.run(0.05, lambda times: [])
    assert not len(standing()) and not (stage.tracker.map.log_odds > 0.0).any()
    stage.run(0.5, lambda times: POSTS)
    assert len(standing())
