import math

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core import se2
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.obstacles.environment import Environment
from omniman_ros.planning.obstacles.walls import Walls
from omniman_ros.planning.route.route_planner import (
    CHECK_PERIOD,
    GAP_WINDOW,
    LATER_TRY_PACE,
    MIN_KEPT_GAP,
    RETRY_DELAY,
    SEARCH_GAP,
    SEARCH_WORK,
    SECOND_TRY_PACE,
    SHORT_ROUTE_PACE,
    SLOWEST_DISTANCE,
    STUCK_TIME,
    RoutePlanner,
    RouteSource,
)
from omniman_ros.surroundings.grid_map import GridMap
from test.planning.support import CYCLE, ellipses, model, parameters

ROBOT = model("ig42")
HALF = ROBOT.half
WIDE = math.hypot(*HALF)  #: Radius of the box [m]
ROOM = {
    "workspace__x_min": -2.0,
    "workspace__x_max": 6.0,
    "workspace__y_min": -2.0,
    "workspace__y_max": 2.0,
}  #: Of 8 x 4 m


def a_row(x, first, last, radius=0.15):
    """Return a row of obstacles across the way, spaced closer than the robot is wide."""
    return [(x, y, radius) for y in np.arange(first, last + 1e-9, 0.25)]


class FollowedRoute:
    """A route planner with a robot that follows its targets exactly, in cycles of 50 ms.

    Attributes:
        now: Time [s].
        pose: (3,) of the robot.
        known: Standing obstacles.
        moves: Whether the robot moves.
        limit_scale: Scale of the limits.
    """

    def __init__(self, goal, known=None, grid=None, pose=(0.0, 0.0, 0.0), **changes):
        self.p = parameters(**changes)
        self.planner = RoutePlanner(ROBOT, np.array(goal, float))
        self.known = ellipses() if known is None else known
        self.grid = grid
        self.now, self.pose, self.limit_scale = 100.0, np.array(pose, float), 1.0
        self.twist = np.zeros(3)
        self.moves = True

    @property
    def environment(self):
        walls = Walls.none() if self.grid is None else Walls(*self.grid.obstacles())
        return Environment(
            Footprint(Rectangles.centred(HALF)),
            self.known,
            self.p.workspace.bounds,
            self.grid,
            walls,
        )

    @property
    def limits(self):
        return EffectiveLimits(self.p, self.limit_scale)

    @property
    def route(self):
        assert self.planner.route is not None
        return self.planner.route

    def look(self, work=SEARCH_WORK):
        self.planner.update(self.now, self.pose, self.environment, self.limits, work)

    def along(self):
        start = np.concatenate([self.pose, self.twist])
        return self.planner.goal_from(start, self.now, self.limits)

    def cycle(self, work=SEARCH_WORK):
        if not self.planner.is_waiting:
            targets, _ = self.along().targets(np.array([self.now + CYCLE]))
            if self.moves:
                velocity = (targets[0] - self.pose) / CYCLE
                self.pose, self.twist = targets[0], se2.to_robot(float(targets[0, 2]), velocity)
            else:
                self.twist = np.zeros(3)
        self.now += CYCLE
        self.look(work)

    def run(self, seconds, until=None):
        """Run cycles for a time or until a condition holds; return whether it came to hold."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.cycle()
            if until is not None and until():
                return True
        return until is None

    def searches(self):
        return self.planner.source is RouteSource.SEARCH

    def has_a_route(self):
        return self.planner.source is RouteSource.ROUTE

    def gaps(self):
        """Return the gaps along the route."""
        return self.environment.gaps(self.route.samples(np.hypot(*HALF))[1], 0.3)


# ---- the straight line ------------------------------------------------------------------------


def test_route_over_open_floor_is_the_straight_line():
    led = FollowedRoute((3.0, 0.0, 0.5))
    led.look(work=0)
    assert led.planner.source is RouteSource.STRAIGHT_LINE and not led.planner.is_waiting
    np.testing.assert_allclose(led.route.poses, [[0, 0, 0], [3.0, 0, 0.5]])
    assert led.run(8.0, lambda: np.abs(led.pose - [3.0, 0.0, 0.5]).max() < 1e-6)
    assert led.planner.source is RouteSource.STRAIGHT_LINE and not led.planner.failure


def test_heading_of_the_line_is_on_the_branch_of_the_robot():
    for turns in (-3, 0, 40):
        led = FollowedRoute((3.0, 0.0, -3.0), pose=(0.0, 0.0, 3.0 + turns * math.tau))
        led.look(work=0)
        assert np.abs(np.diff(led.route.poses[[0, -1], 2])) == pytest.approx(math.tau - 6.0)


def beside(distance):
    """Return obstacles on both sides of a way to the left, where the robot would turn."""
    rows = [(s * (distance + 0.1), y, 0.1) for s in (-1, 1) for y in np.arange(0.0, 1.4, 0.1)]
    return ellipses(*rows)


def test_energy_saving_turn_is_omitted_where_only_the_plain_line_fits():
    goal = (0.0, 4.0, 0.0)
    tight, wide = HALF[0] + 0.07, WIDE + 0.1
    assert tight < WIDE
    led = FollowedRoute(goal, beside(wide))
    led.look(work=0)
    assert led.planner.source is RouteSource.STRAIGHT_LINE and len(led.route.poses) == 4
    led = FollowedRoute(goal, beside(tight))
    led.look(work=0)
    assert led.planner.source is RouteSource.STRAIGHT_LINE and len(led.route.poses) == 2
    assert led.gaps().min() > led.p.safety.clearance
    led = FollowedRoute(goal, beside(HALF[0] + 0.04))  # not even the plain line fits
    led.look(work=0)
    assert led.searches()


def test_pace_is_lowered_on_short_routes():
    led = FollowedRoute((0.5, 0.0, 0.0))
    led.look(work=0)
    along = led.along()
    assert along.max_pace == pytest.approx(
        SHORT_ROUTE_PACE * math.sqrt(along.rate * led.route.duration)
    )
    assert along.max_pace < 0.9
    led = FollowedRoute((5.0, 0.0, 0.0))
    led.look(work=0)
    assert led.along().max_pace == 1.0


# ---- the search -------------------------------------------------------------------------------


def test_search_in_slices_finds_the_way_around():
    led = FollowedRoute((3.0, 0.0, 0.0), ellipses(*a_row(1.5, -1.5, 1.5)))
    led.look(work=0)
    assert led.searches() and led.planner.is_waiting and led.planner.route is None
    calls = 0
    while led.searches():
        led.now += CYCLE
        led.look()
        calls += 1
        assert calls < 200
    assert calls > 2
    assert led.has_a_route() and not led.planner.is_waiting and not led.planner.failure
    np.testing.assert_allclose(led.route.poses[0], led.pose)
    np.testing.assert_allclose(led.route.poses[-1], [3.0, 0.0, 0.0], atol=1e-9)
    assert led.gaps().min() > 0.0
    assert np.abs(led.route.poses[:, 1]).max() > 1.6
    assert led.run(20.0, lambda: np.abs(led.pose - [3.0, 0.0, 0.0]).max() < 1e-6)


def test_larger_slices_mean_fewer_calls():
    calls = []
    for work in (2000, 20000):
        led = FollowedRoute((3.0, 0.0, 0.0), ellipses(*a_row(1.5, -1.5, 1.5)))
        led.look(work=0)
        count = 0
        while led.searches() and count < 400:
            led.look(work)
            count += 1
        calls.append(count)
    assert calls[1] < 0.3 * calls[0] < 120


def test_new_obstacle_is_bypassed_until_it_disappears():
    led = FollowedRoute((5.0, 0.0, 0.0))
    led.run(0.5)
    assert led.planner.source is RouteSource.STRAIGHT_LINE
    old = led.route
    led.known = ellipses(*a_row(3.0, -0.75, 0.75))
    assert led.run(CHECK_PERIOD + 2 * CYCLE, led.searches)
    assert led.planner.route is old and not led.planner.is_waiting, "until another is found"
    assert led.run(3.0, led.has_a_route)
    led.cycle()
    assert led.gaps().min() > 0.0
    first = led.route
    led.run(0.6)
    assert led.route is first and led.has_a_route(), "it is kept as long as it is clear"
    led.known = ellipses(*a_row(3.0, -0.75, 0.75), (*first.at(np.array([4.0]))[0, :2], 0.3))
    assert led.run(3.0, lambda: led.route is not first and led.has_a_route())
    led.known = ellipses()
    assert led.run(
        CHECK_PERIOD + 2 * CYCLE, lambda: led.planner.source is RouteSource.STRAIGHT_LINE
    )
    assert led.run(10.0, lambda: np.abs(led.pose - [5.0, 0.0, 0.0]).max() < 1e-6)


def test_a_route_that_is_blocked_ahead_is_searched_anew_in_the_next_cycle():
    led = FollowedRoute((5.0, 0.0, 0.0))
    led.run(2.5 * CHECK_PERIOD)
    led.known = ellipses(*a_row(led.pose[0] + 1.5, -0.75, 0.75))
    assert not led.searches()
    led.cycle()
    assert led.searches()


def test_a_search_begins_ahead_on_the_clear_part_and_its_route_is_joined_there():
    led = FollowedRoute((5.0, 0.0, 0.0))
    led.run(2.0)
    before = led.route
    led.known = ellipses(*a_row(led.pose[0] + 2.0, -0.75, 0.75))
    led.cycle(work=0)
    assert led.searches() and led.route is before
    targets, _ = led.along().targets(led.now + np.arange(0.0, 5.0, 0.1))
    place = targets[-1]
    assert led.pose[0] + 0.2 < place[0] < 5.0, "ahead of the robot"
    assert led.environment.gaps(targets, 0.3).min() > SEARCH_GAP - 0.02, "not into what is new"
    for _ in range(40):
        led.cycle(work=0)
    np.testing.assert_allclose(led.pose, place, atol=1e-6, err_msg="it waits there")
    led.look(work=10**6)
    assert led.has_a_route()
    start = led.route.project(led.pose)
    assert led.route.at(np.array([start]))[0] == pytest.approx(led.pose, abs=1e-6)
    assert led.gaps().min() > 0.0
    assert led.run(10.0, lambda: np.abs(led.pose - [5.0, 0.0, 0.0]).max() < 1e-6)


def test_a_route_that_is_found_early_leads_on_from_the_old_one():
    led = FollowedRoute((5.0, 0.0, 0.0))
    led.run(2.0)
    before = led.route
    led.known = ellipses(*a_row(led.pose[0] + 2.0, -0.75, 0.75))
    led.cycle(work=0)
    place = led.along().targets(np.array([led.now + 9.0]))[0][0]
    led.look(work=10**6)
    assert led.has_a_route()
    joint = led.route.project(place)
    assert joint > 0.1 and led.route.at(np.array([joint]))[0] == pytest.approx(place, abs=1e-6)
    shared = led.route.at(np.linspace(0.0, joint, 9))
    on_old = before.at(np.array([before.project(pose) for pose in shared]))
    np.testing.assert_allclose(shared, on_old, atol=1e-6)


def test_a_robot_waits_before_a_goal_that_something_stands_on():
    led = FollowedRoute((4.0, 0.0, 0.0))
    led.run(1.0)
    led.known = ellipses((4.1, 0.1, 0.2))
    assert not led.run(12.0, lambda: led.searches() or bool(led.planner.failure))
    gap = led.environment.gaps(led.pose[None], 1.0)[0]
    assert 0.05 < gap < 0.3 and not led.planner.is_stuck(led.now), "near it, and patient"
    led.known = ellipses()
    assert led.run(10.0, lambda: np.abs(led.pose - [4.0, 0.0, 0.0]).max() < 1e-6)


def test_a_goal_in_a_tight_place_is_not_searched_for_again_and_again():
    goal = (4.0, 0.0, 0.0)
    beside = ellipses((4.0, HALF[1] + 0.206, 0.2))
    led = FollowedRoute(goal, beside)
    led.look(work=0)
    assert led.run(10.0, led.has_a_route) and 0.0 < led.gaps()[-1] < MIN_KEPT_GAP
    first = led.route
    assert led.run(10.0, lambda: np.abs(led.pose - goal).max() < 1e-6)
    assert led.route is first


def test_routes_do_not_alternate_while_nothing_changes():
    led = FollowedRoute((4.0, 0.0, 0.0), ellipses(*a_row(2.0, -1.0, 1.0)))
    adopted = []
    led.look(work=0)
    for _ in range(160):
        led.cycle()
        if led.planner.route is not None and (not adopted or adopted[-1] is not led.planner.route):
            adopted.append(led.planner.route)
    # First the way around, then the straight line once the goal is in sight.
    assert 1 <= len(adopted) <= 2
    np.testing.assert_allclose(led.pose, [4.0, 0.0, 0.0], atol=1e-6)


def test_walls_of_a_map_are_bypassed():
    cells = np.zeros((80, 100), dtype=bool)
    cells[:60, 50:52] = True
    led = FollowedRoute((3.0, 0.0, 0.0), grid=GridMap(cells, 0.05, np.array([-1.0, -2.0, 0.0])))
    led.look(work=0)
    assert led.searches()
    assert led.run(5.0, led.has_a_route)
    assert led.gaps().min() > 0.0
    assert led.route.poses[:, 1].max() > 1.0
    led.grid = None
    assert led.run(
        CHECK_PERIOD + 2 * CYCLE, lambda: led.planner.source is RouteSource.STRAIGHT_LINE
    )


def a_hook():
    """Return a wall across the way to the goal, open on one side, as a map."""
    cells = np.zeros((80, 160), dtype=bool)
    cells[:60, 60:62] = True
    return GridMap(cells, 0.05, np.array([-1.0, -2.0, 0.0]))


def test_targets_end_where_the_route_goes_behind_a_wall():
    led = FollowedRoute((3.0, -0.2, 0.0), grid=a_hook(), pose=(1.5, 0.0, 0.0))
    led.look(work=0)
    assert led.run(5.0, led.has_a_route) and led.route.poses[:, 1].max() > 1.0
    end = led.along().targets(np.array([led.now + 60.0]))[0][0]
    assert end[0] < 2.2 and end[1] > 1.0, "above the end of the wall"
    assert led.run(15.0, lambda: np.abs(led.pose - [3.0, -0.2, 0.0]).max() < 1e-6)


def test_a_robot_that_is_on_the_other_side_of_a_wall_than_its_route_gets_another():
    led = FollowedRoute((3.0, -1.0, 0.0), grid=a_hook(), pose=(1.2, 0.4, 0.0))
    led.look(work=0)
    assert led.run(5.0, led.has_a_route)
    led.pose = led.pose + [0.0, -0.6, 0.0]
    led.along()
    led.look()
    assert not led.searches(), "nothing is between"
    led.pose = np.array([2.6, 0.4, 0.0])
    led.along()
    led.look()
    assert led.searches()
    led.look(work=10**6)
    assert not led.searches() and led.route.poses[0] == pytest.approx(led.pose)


# ---- clearance --------------------------------------------------------------------------------


def a_door(gap):
    """Return a wall with a door that leaves a given gap on both sides of the robot."""
    side = HALF[1] + gap + 0.15
    rows = [(2.0, s * y, 0.15) for s in (-1, 1) for y in (*np.arange(side, 2.0, 0.2), 2.0)]
    return ellipses(*rows)


def test_clearance_is_reduced_in_tight_places_only():
    door, behind = a_door(0.035), ellipses((4.4, 0.0, 0.25))
    led = FollowedRoute((5.4, 0.0, 0.0), door.joined(behind), pose=(-1.4, 0.0, 0.0), **ROOM)
    usual, least = led.p.safety.clearance, led.p.safety.least_clearance
    led.look(work=0)
    assert led.searches()
    assert led.run(20.0, led.has_a_route)
    assert led.gaps().min() > 0.5 * least
    seen = []
    for _ in range(300):
        led.cycle()
        seen.append((led.pose[0], led.planner.clearance(led.limits), led.has_a_route()))
    at, clearance, routed = np.array(seen).T
    assert at[-1] == pytest.approx(5.4, abs=1e-6)
    assert clearance.max() == usual and clearance.min() >= least
    inside = (at > 2.0 - HALF[0]) & (at < 2.0 + HALF[0])
    assert clearance[inside].max() < 0.04 and inside.sum() > 10
    # Only the part within the horizon of the next plan matters, not the part behind.
    far = (led.p.horizon.duration + GAP_WINDOW) * EffectiveLimits(led.p).speeds[0]
    before, after = at < 2.0 - WIDE - 0.2 - far, (at > 2.0 + WIDE + 0.5) & (routed > 0)
    assert before.sum() > 3 and after.sum() > 3
    assert (clearance[before] == usual).all() and (clearance[after] == usual).all()


def test_clearance_is_not_reduced_where_there_is_room():
    led = FollowedRoute((5.0, 0.0, 0.0))
    assert led.planner.clearance(led.limits) == led.p.safety.clearance
    led.run(2.0)
    assert led.planner.clearance(led.limits) == led.p.safety.clearance
    led.p = parameters(safety__clearance=0.3)
    assert led.planner.clearance(led.limits) == 0.3


def test_changed_clearance_starts_a_new_search():
    led = FollowedRoute((4.0, 0.0, 0.0), ellipses(*a_row(2.0, -1.0, 1.0)))
    led.look(work=0)
    assert led.run(5.0, led.has_a_route)
    assert not led.run(CHECK_PERIOD + 2 * CYCLE, led.searches)
    led.p = parameters(safety__clearance=0.2)
    assert led.run(CHECK_PERIOD + 2 * CYCLE, led.searches)
    assert led.run(5.0, led.has_a_route)
    assert led.gaps().min() > 0.1


# ---- stuck ------------------------------------------------------------------------------------


def test_stuck_robot_searches_another_route_and_then_slows_down():
    led = FollowedRoute((5.0, 0.0, 0.0))
    led.run(0.5)
    led.moves = False
    assert not led.planner.is_stuck(led.now)
    assert not led.run(STUCK_TIME - 0.5, led.searches)
    assert led.run(0.6, led.searches), "a search, though the line is clear"
    assert led.run(3.0, lambda: not led.searches())
    assert led.along().max_pace > SECOND_TRY_PACE and not led.planner.is_stuck(led.now), (
        "once is no rule"
    )
    assert led.run(STUCK_TIME + 0.2, led.searches)
    led.run(3.0, lambda: not led.searches())
    assert led.along().max_pace == SECOND_TRY_PACE
    # If that does not help, the robot slows down further; then it recovers stepwise.
    assert led.run(STUCK_TIME + 0.2, led.searches)
    led.run(3.0, lambda: not led.searches())
    assert led.along().max_pace == LATER_TRY_PACE and not led.planner.is_stuck(led.now)
    led.moves = True
    assert led.run(10.0, lambda: led.along().max_pace == SECOND_TRY_PACE)
    assert led.along().position == pytest.approx(SLOWEST_DISTANCE, abs=0.15)
    # Once free, the robot returns to full speed after a while.
    begin = led.pose[0]
    assert led.run(20.0, lambda: led.along().max_pace > SECOND_TRY_PACE)
    assert 0.4 < led.pose[0] - begin < 1.0
    assert led.run(20.0, lambda: np.abs(led.pose - [5.0, 0.0, 0.0]).max() < 1e-6)


def test_slow_robot_is_not_stuck():
    led = FollowedRoute((5.0, 0.0, 0.0))
    led.limit_scale = 0.01
    led.run(0.2)
    assert not led.run(20.0, led.searches)
    assert 0.01 < led.pose[0] < 0.5


def test_pause_between_cycles_is_not_taken_for_stuck():
    led = FollowedRoute((5.0, 0.0, 0.0))
    led.run(1.0)
    led.moves = False
    led.now += 60.0
    led.look()
    assert not led.planner.is_stuck(led.now) and not led.searches()
    led.run(STUCK_TIME + 0.3, led.searches)
    assert led.searches()


# ---- live ------------------------------------------------------------------------------------


@pytest.mark.parametrize("fraction", [0.4, 0.01])
def test_changed_limits_keep_the_place_on_the_route(fraction):
    led = FollowedRoute((5.0, 0.0, 0.0), a_door(0.035), **ROOM)
    led.look(work=0)
    assert led.run(20.0, lambda: led.pose[0] > 1.9) and led.has_a_route()
    before, clearance = led.along(), led.planner.clearance(led.limits)
    assert clearance < led.p.safety.clearance
    here = before.targets(np.array([led.now]))[0]
    led.limit_scale = fraction
    after = led.along()
    assert after.route.speeds == EffectiveLimits(led.p, fraction).speeds
    np.testing.assert_array_equal(after.route.poses, before.route.poses)
    np.testing.assert_allclose(after.targets(np.array([led.now]))[0], here, atol=1e-6)
    assert after.position == pytest.approx(before.position / fraction, rel=1e-6)
    assert led.planner.clearance(led.limits) < led.p.safety.clearance, "it is still in the door"
    led.limit_scale = 1.0
    back = led.along()
    assert back.position == pytest.approx(before.position, rel=1e-6)
    assert led.planner.clearance(led.limits) == pytest.approx(clearance)


def test_targets_never_go_back_and_follow_the_pace_of_the_robot():
    led = FollowedRoute((5.0, 0.0, 0.0))
    led.run(1.5)
    along = led.along()
    speed = float(np.hypot(*led.twist[:2]))
    assert along.pace == pytest.approx(speed / EffectiveLimits(led.p).speeds[0], rel=0.05)
    place = along.position
    led.pose = led.pose - [0.3, 0.0, 0.0]
    assert led.along().position == place


# ---- no way -----------------------------------------------------------------------------------


def test_missing_route_is_reported_and_a_new_opening_is_found():
    ring = [
        (4.0 + 0.9 * math.cos(a), 0.9 * math.sin(a), 0.25) for a in np.arange(16) * math.pi / 8
    ]
    led = FollowedRoute((4.0, 0.0, 0.0), ellipses(*ring), **ROOM)
    led.look(work=0)
    assert led.run(30.0, lambda: bool(led.planner.failure))
    assert "no" in led.planner.failure
    stands, told = led.pose, led.now
    led.cycle()
    assert led.planner.source is RouteSource.REST
    np.testing.assert_allclose(led.pose, stands, atol=1e-9)
    assert led.run(RETRY_DELAY + 0.2, led.searches) and led.now - told > 1.0, "not at once again"
    assert led.planner.failure, "until something is found"
    np.testing.assert_allclose(led.pose, stands, atol=1e-9)
    led.known = ellipses(*[row for row in ring if row[0] < 4.5])
    assert led.run(30.0, lambda: not led.planner.failure)
    assert led.run(5.0, led.has_a_route) or led.planner.source is RouteSource.STRAIGHT_LINE
    assert led.gaps().min() > 0.0
    assert led.run(30.0, lambda: np.abs(led.pose - [4.0, 0.0, 0.0]).max() < 1e-6)


def test_newly_clear_straight_line_is_used_without_a_search():
    turn = np.arange(16) * math.pi / 8
    ring = [(4.0 + 0.9 * math.cos(a), 0.9 * math.sin(a), 0.25) for a in turn]
    led = FollowedRoute((4.0, 0.0, 0.0), ellipses(*ring), **ROOM)
    led.look(work=0)
    assert led.run(30.0, lambda: bool(led.planner.failure))
    led.known = ellipses()
    assert not led.run(RETRY_DELAY + 2 * CYCLE, led.searches)
    assert not led.planner.failure and led.planner.source is RouteSource.STRAIGHT_LINE


def test_goal_at_the_pose_of_the_robot_is_valid():
    for goal in ((0.0, 0.0, 0.0), (1e-9, 0.0, 0.0), (0.0, 0.0, 3.1)):
        led = FollowedRoute(goal)
        led.look(work=0)
        led.run(STUCK_TIME + 4.0)
        np.testing.assert_allclose(led.pose, goal, atol=1e-6)
        assert not led.planner.failure


def test_input_that_prevents_a_search_is_reported_and_never_raised():
    led = FollowedRoute((3.0, 0.0, 0.0), ellipses(*a_row(1.5, -1.5, 1.5), (2e6, 0.0, 0.3)))
    led.look(work=0)
    for _ in range(3):
        led.cycle()
    assert "not finite or beyond" in led.planner.failure
    led.known = ellipses(*a_row(1.5, -1.5, 1.5))
    assert led.run(RETRY_DELAY + 5.0, lambda: led.has_a_route() and not led.planner.failure)


# ---- goals that move with their frame ---------------------------------------------------------


def test_a_route_is_bent_to_a_goal_that_drifts():
    led = FollowedRoute((5.0, 0.0, 0.0))
    led.run(2.0)
    begin, position = led.route.poses[0].copy(), led.along().position
    for i in range(100):
        goal = np.array([5.0, 1e-3 * i, 1e-3 * i])
        assert led.planner.follows(goal)
    assert led.route.poses[-1] == pytest.approx(goal, abs=1e-3)
    assert led.route.poses[0] == pytest.approx(begin)
    assert led.along().position == pytest.approx(position, abs=0.05)
    led.run(20.0)
    assert led.pose == pytest.approx(goal, abs=1e-3)


def test_a_goal_that_jumps_needs_another_route():
    led = FollowedRoute((5.0, 0.0, 0.0))
    led.run(2.0)
    goal = np.array([5.0, 0.2, 0.0])
    assert not led.planner.follows(goal)
    led.planner = led.planner.restarted(goal)
    led.run(20.0)
    assert led.pose == pytest.approx(goal, abs=1e-6)


def test_a_search_goes_on_while_the_goal_drifts():
    led = FollowedRoute((4.0, 0.0, 0.0), ellipses(*a_row(2.0, -1.0, 1.0)))
    led.look(work=0)
    assert led.searches()
    goal = np.array([4.0, 0.02, 0.0])
    assert led.planner.follows(goal) and led.searches()
    assert led.run(5.0, led.has_a_route)
    assert led.planner.follows(goal) and led.route.poses[-1] == pytest.approx(goal)
