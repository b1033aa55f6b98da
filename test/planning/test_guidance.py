import math

import numpy as np
import pytest

from omniman_ros.core import se2
from omniman_ros.planning import guidance
from omniman_ros.planning.floor import Floor
from omniman_ros.planning.grid_map import GridMap
from omniman_ros.planning.guidance import (
    AGAIN,
    EASE,
    LOOK,
    SLOW,
    SLOWEST,
    STUCK,
    WORK,
    Guide,
)
from omniman_ros.planning.walls import Walls

from .support import CYCLE, ellipses, model, parameters

ROBOT = model("ig42")
HALF = ROBOT.half
WIDE = math.hypot(*HALF)
"""Radius of the box [m]."""
ROOM = {"workspace__x_min": -2.0, "workspace__x_max": 6.0, "workspace__y_min": -2.0,
        "workspace__y_max": 2.0}  # fmt: skip
"""Of 8 x 4 m."""


def a_row(x, first, last, radius=0.15):
    """Obstacles across the way, closer than the robot is wide."""
    return [(x, y, radius) for y in np.arange(first, last + 1e-9, 0.25)]


class Led:
    """A guide, and a robot that is where the targets have it, 50 ms from cycle to cycle.

    Attributes:
        now: Time [s].
        pose: (3,) of the robot.
        known: Obstacles that stand.
        moves: Whether the robot goes at all.
        share: Of the limits.
    """

    def __init__(self, goal, known=None, grid=None, pose=(0.0, 0.0, 0.0), **changes):
        self.p = parameters(**changes)
        self.guide = Guide(ROBOT, np.array(goal, float))
        self.known = ellipses() if known is None else known
        self.grid = grid
        self.now, self.pose, self.share = 100.0, np.array(pose, float), 1.0
        self.twist = np.zeros(3)
        self.moves = True

    @property
    def floor(self):
        walls = Walls.none() if self.grid is None else Walls(*self.grid.obstacles())
        return Floor(self.known, self.p.workspace.bounds, self.grid, walls)

    @property
    def route(self):
        assert self.guide.route is not None
        return self.guide.route

    def look(self, work=WORK):
        self.guide.look(self.now, self.pose, self.floor, self.p, self.share, work)

    def along(self):
        start = np.concatenate([self.pose, self.twist])
        return self.guide.along(start, self.now, self.p, self.share)

    def cycle(self, work=WORK):
        if not self.guide.waiting:
            targets, _ = self.along().targets(np.array([self.now + CYCLE]))
            if self.moves:
                velocity = (targets[0] - self.pose) / CYCLE
                self.pose, self.twist = targets[0], se2.to_robot(float(targets[0, 2]), velocity)
            else:
                self.twist = np.zeros(3)
        self.now += CYCLE
        self.look(work)

    def run(self, seconds, until=None):
        """Cycle for so long, or until it is so; whether it came to that."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.cycle()
            if until is not None and until():
                return True
        return until is None

    def searches(self):
        return self.guide.state == "searches"

    def has_a_route(self):
        return self.guide.state == "a route"

    def gaps(self):
        """Along the whole route."""
        return self.floor.gaps(self.route.samples(HALF)[1], HALF, 0.3)


# ---- the straight line ------------------------------------------------------------------------


def test_open_floor_is_crossed_on_the_straight_line():
    led = Led((3.0, 0.0, 0.5))
    led.look(work=0)
    assert led.guide.state == "a straight line" and not led.guide.waiting
    np.testing.assert_allclose(led.route.poses, [[0, 0, 0], [3.0, 0, 0.5]])
    assert led.run(8.0, lambda: np.abs(led.pose - [3.0, 0.0, 0.5]).max() < 1e-6)
    assert led.guide.state == "a straight line" and not led.guide.lost


def test_the_heading_of_the_line_is_on_the_branch_of_the_robot():
    for turns in (-3, 0, 40):
        led = Led((3.0, 0.0, -3.0), pose=(0.0, 0.0, 3.0 + turns * math.tau))
        led.look(work=0)
        assert np.abs(np.diff(led.route.poses[[0, -1], 2])) == pytest.approx(math.tau - 6.0)


def beside(distance):
    """Obstacles on both sides of a way to the left, where a robot would turn."""
    rows = [(s * (distance + 0.1), y, 0.1) for s in (-1, 1) for y in np.arange(0.0, 1.4, 0.1)]
    return ellipses(*rows)


def test_the_turn_that_saves_energy_is_left_out_where_only_the_plain_line_fits():
    goal = (0.0, 4.0, 0.0)
    tight, wide = HALF[0] + 0.07, WIDE + 0.1
    assert tight < WIDE
    led = Led(goal, beside(wide))
    led.look(work=0)
    assert led.guide.state == "a straight line" and len(led.route.poses) == 4
    led = Led(goal, beside(tight))
    led.look(work=0)
    assert led.guide.state == "a straight line" and len(led.route.poses) == 2
    assert led.gaps().min() > led.p.safety.clearance
    led = Led(goal, beside(HALF[0] + 0.04))  # not even that
    led.look(work=0)
    assert led.searches()


def test_short_ways_are_driven_with_ease():
    led = Led((0.5, 0.0, 0.0))
    led.look(work=0)
    along = led.along()
    assert along.most == pytest.approx(EASE * math.sqrt(along.rate * led.route.duration))
    assert along.most < 0.9
    led = Led((5.0, 0.0, 0.0))
    led.look(work=0)
    assert led.along().most == 1.0


# ---- the search -------------------------------------------------------------------------------


def test_a_search_in_slices_finds_the_way_around():
    led = Led((3.0, 0.0, 0.0), ellipses(*a_row(1.5, -1.5, 1.5)))
    led.look(work=0)
    assert led.searches() and led.guide.waiting and led.guide.route is None
    calls = 0
    while led.searches():
        led.now += CYCLE
        led.look()
        calls += 1
        assert calls < 200
    assert calls > 2
    assert led.has_a_route() and not led.guide.waiting and not led.guide.lost
    np.testing.assert_allclose(led.route.poses[0], led.pose)
    np.testing.assert_allclose(led.route.poses[-1], [3.0, 0.0, 0.0], atol=1e-9)
    assert led.gaps().min() > 0.0
    assert np.abs(led.route.poses[:, 1]).max() > 1.6
    assert led.run(20.0, lambda: np.abs(led.pose - [3.0, 0.0, 0.0]).max() < 1e-6)


def test_more_work_in_a_call_means_fewer_calls():
    calls = []
    for work in (2000, 20000):
        led = Led((3.0, 0.0, 0.0), ellipses(*a_row(1.5, -1.5, 1.5)))
        led.look(work=0)
        count = 0
        while led.searches() and count < 400:
            led.look(work)
            count += 1
        calls.append(count)
    assert calls[1] < 0.3 * calls[0] < 120


def test_what_comes_to_stand_on_the_way_is_gone_around_and_forgotten_when_it_goes():
    led = Led((5.0, 0.0, 0.0))
    led.run(0.5)
    assert led.guide.state == "a straight line"
    old = led.route
    led.known = ellipses(*a_row(3.0, -0.75, 0.75))
    assert led.run(LOOK + 2 * CYCLE, led.searches)
    assert led.guide.route is old and not led.guide.waiting, "until another is found"
    assert led.run(3.0, led.has_a_route)
    led.cycle()
    assert led.gaps().min() > 0.0
    first = led.route
    led.run(0.6)
    assert led.route is first and led.has_a_route(), "it is kept as long as it is clear"
    led.known = ellipses(*a_row(3.0, -0.75, 0.75), (*first.at(np.array([4.0]))[0, :2], 0.3))
    assert led.run(3.0, lambda: led.route is not first and led.has_a_route())
    led.known = ellipses()
    assert led.run(LOOK + 2 * CYCLE, lambda: led.guide.state == "a straight line")
    assert led.run(10.0, lambda: np.abs(led.pose - [5.0, 0.0, 0.0]).max() < 1e-6)


def test_routes_do_not_alternate_while_nothing_changes():
    led = Led((4.0, 0.0, 0.0), ellipses(*a_row(2.0, -1.0, 1.0)))
    adopted = []
    led.look(work=0)
    for _ in range(160):
        led.cycle()
        if led.guide.route is not None and (not adopted or adopted[-1] is not led.guide.route):
            adopted.append(led.guide.route)
    # The way around, and once the goal is in sight the straight line.
    assert 1 <= len(adopted) <= 2
    np.testing.assert_allclose(led.pose, [4.0, 0.0, 0.0], atol=1e-6)


def test_walls_of_a_map_are_gone_around():
    cells = np.zeros((80, 100), dtype=bool)
    cells[:60, 50:52] = True
    led = Led((3.0, 0.0, 0.0), grid=GridMap(cells, 0.05, np.array([-1.0, -2.0, 0.0])))
    led.look(work=0)
    assert led.searches()
    assert led.run(5.0, led.has_a_route)
    assert led.gaps().min() > 0.0
    assert led.route.poses[:, 1].max() > 1.0
    led.grid = None
    assert led.run(LOOK + 2 * CYCLE, lambda: led.guide.state == "a straight line")


# ---- clearance --------------------------------------------------------------------------------


def a_door(gap):
    """A wall across the room with a door that leaves such a gap on both sides of the robot."""
    side = HALF[1] + gap + 0.15
    rows = [(2.0, s * y, 0.15) for s in (-1, 1) for y in (*np.arange(side, 2.0, 0.2), 2.0)]
    return ellipses(*rows)


def test_clearance_is_lowered_at_a_tight_place_only():
    door, behind = a_door(0.035), ellipses((4.4, 0.0, 0.25))
    led = Led((5.4, 0.0, 0.0), door.joined(behind), pose=(-1.4, 0.0, 0.0), **ROOM)
    usual, least = led.p.safety.clearance, led.p.safety.least_clearance
    led.look(work=0)
    assert led.searches()
    assert led.run(20.0, led.has_a_route)
    assert led.gaps().min() > 0.5 * least
    seen = []
    for _ in range(300):
        led.cycle()
        seen.append((led.pose[0], led.guide.clearance(led.p), led.has_a_route()))
    at, clearance, routed = np.array(seen).T
    assert at[-1] == pytest.approx(5.4, abs=1e-6)
    assert clearance.max() == usual and clearance.min() >= least
    inside = (at > 2.0 - HALF[0]) & (at < 2.0 + HALF[0])
    assert clearance[inside].max() < 0.04 and inside.sum() > 10
    # The next plan goes no further than its horizon, and what is passed is passed.
    far = (led.p.horizon.duration + guidance.BESIDE) * led.p.speeds()[0]
    before, after = at < 2.0 - WIDE - 0.2 - far, (at > 2.0 + WIDE + 0.5) & (routed > 0)
    assert before.sum() > 3 and after.sum() > 3
    assert (clearance[before] == usual).all() and (clearance[after] == usual).all()


def test_clearance_is_the_usual_one_where_there_is_room():
    led = Led((5.0, 0.0, 0.0))
    assert led.guide.clearance(led.p) == led.p.safety.clearance
    led.run(2.0)
    assert led.guide.clearance(led.p) == led.p.safety.clearance
    led.p = parameters(safety__clearance=0.3)
    assert led.guide.clearance(led.p) == 0.3


def test_another_clearance_begins_another_search():
    led = Led((4.0, 0.0, 0.0), ellipses(*a_row(2.0, -1.0, 1.0)))
    led.look(work=0)
    assert led.run(5.0, led.has_a_route)
    assert not led.run(LOOK + 2 * CYCLE, led.searches)
    led.p = parameters(safety__clearance=0.2)
    assert led.run(LOOK + 2 * CYCLE, led.searches)
    assert led.run(5.0, led.has_a_route)
    assert led.gaps().min() > 0.1


# ---- stuck ------------------------------------------------------------------------------------


def test_a_robot_that_does_not_come_on_looks_for_another_way_and_at_last_goes_slowly():
    led = Led((5.0, 0.0, 0.0))
    led.run(0.5)
    led.moves = False
    assert not led.guide.stuck(led.now)
    assert not led.run(STUCK - 0.5, led.searches)
    assert led.run(0.6, led.searches), "a search, though the line is clear"
    assert led.run(3.0, lambda: not led.searches())
    assert led.along().most > SLOW and not led.guide.stuck(led.now), "once is no rule"
    assert led.run(STUCK + 0.2, led.searches)
    led.run(3.0, lambda: not led.searches())
    assert led.along().most == SLOW
    # Where that does not help it goes slower still, and comes back to that first.
    assert led.run(STUCK + 0.2, led.searches)
    led.run(3.0, lambda: not led.searches())
    assert led.along().most == SLOWEST and not led.guide.stuck(led.now)
    led.moves = True
    assert led.run(10.0, lambda: led.along().most == SLOW)
    assert led.along().place == pytest.approx(guidance.EASED, abs=0.15)
    # It frees itself, and after a while goes as ever.
    begin = led.pose[0]
    assert led.run(20.0, lambda: led.along().most > SLOW)
    assert 0.4 < led.pose[0] - begin < 1.0
    assert led.run(20.0, lambda: np.abs(led.pose - [5.0, 0.0, 0.0]).max() < 1e-6)


def test_a_slow_robot_is_not_stuck():
    led = Led((5.0, 0.0, 0.0))
    led.share = 0.01
    led.run(0.2)
    assert not led.run(20.0, led.searches)
    assert 0.01 < led.pose[0] < 0.5


def test_nobody_looked_for_a_while_is_not_stuck():
    led = Led((5.0, 0.0, 0.0))
    led.run(1.0)
    led.moves = False
    led.now += 60.0
    led.look()
    assert not led.guide.stuck(led.now) and not led.searches()
    led.run(STUCK + 0.3, led.searches)
    assert led.searches()


# ---- live ------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.4, 0.01])
def test_live_limits_keep_the_place(share):
    led = Led((5.0, 0.0, 0.0), a_door(0.035), **ROOM)
    led.look(work=0)
    assert led.run(20.0, lambda: led.pose[0] > 1.9) and led.has_a_route()
    before, clearance = led.along(), led.guide.clearance(led.p)
    assert clearance < led.p.safety.clearance
    here = before.targets(np.array([led.now]))[0]
    led.share = share
    after = led.along()
    assert after.route.speeds == led.p.speeds(share)
    np.testing.assert_array_equal(after.route.poses, before.route.poses)
    np.testing.assert_allclose(after.targets(np.array([led.now]))[0], here, atol=1e-6)
    assert after.place == pytest.approx(before.place / share, rel=1e-6)
    assert led.guide.clearance(led.p) < led.p.safety.clearance, "it is still in the door"
    led.share = 1.0
    back = led.along()
    assert back.place == pytest.approx(before.place, rel=1e-6)
    assert led.guide.clearance(led.p) == pytest.approx(clearance)


def test_targets_never_go_back_and_the_pace_is_that_of_the_robot():
    led = Led((5.0, 0.0, 0.0))
    led.run(1.5)
    along = led.along()
    speed = float(np.hypot(*led.twist[:2]))
    assert along.pace == pytest.approx(speed / led.p.speeds()[0], rel=0.05)
    place = along.place
    led.pose = led.pose - [0.3, 0.0, 0.0]
    assert led.along().place == place


# ---- no way -----------------------------------------------------------------------------------


def test_no_way_is_told_and_one_that_opens_is_found():
    ring = [
        (4.0 + 0.9 * math.cos(a), 0.9 * math.sin(a), 0.25) for a in np.arange(16) * math.pi / 8
    ]
    led = Led((4.0, 0.0, 0.0), ellipses(*ring), **ROOM)
    led.look(work=0)
    assert led.run(30.0, lambda: bool(led.guide.lost))
    assert "no" in led.guide.lost
    assert led.guide.route is not None and led.guide.state != "searches", "as near as it gets"
    led.moves = False
    told = led.now
    assert led.run(AGAIN + 0.2, led.searches) and led.now - told > 1.0, "not at once again"
    assert led.guide.lost, "until something is found"
    led.known = ellipses(*[row for row in ring if row[0] < 4.5])
    assert led.run(30.0, lambda: not led.guide.lost)
    assert led.run(5.0, led.has_a_route) or led.guide.state == "a straight line"
    assert led.gaps().min() > 0.0
    led.moves = True
    assert led.run(30.0, lambda: np.abs(led.pose - [4.0, 0.0, 0.0]).max() < 1e-6)


def test_a_straight_line_that_opens_is_taken_without_a_search():
    turn = np.arange(16) * math.pi / 8
    ring = [(4.0 + 0.9 * math.cos(a), 0.9 * math.sin(a), 0.25) for a in turn]
    led = Led((4.0, 0.0, 0.0), ellipses(*ring), **ROOM)
    led.look(work=0)
    assert led.run(30.0, lambda: bool(led.guide.lost))
    led.known = ellipses()
    assert not led.run(AGAIN + 2 * CYCLE, led.searches)
    assert not led.guide.lost and led.guide.state == "a straight line"


def test_a_goal_where_the_robot_is_is_no_trouble():
    for goal in ((0.0, 0.0, 0.0), (1e-9, 0.0, 0.0), (0.0, 0.0, 3.1)):
        led = Led(goal)
        led.look(work=0)
        led.run(STUCK + 4.0)
        np.testing.assert_allclose(led.pose, goal, atol=1e-6)
        assert not led.guide.lost


def test_what_no_search_can_be_made_with_is_told_and_never_raised():
    led = Led((3.0, 0.0, 0.0), ellipses(*a_row(1.5, -1.5, 1.5), (2e6, 0.0, 0.3)))
    led.look(work=0)
    for _ in range(3):
        led.cycle()
    assert "not finite or beyond" in led.guide.lost
    led.known = ellipses(*a_row(1.5, -1.5, 1.5))
    assert led.run(AGAIN + 5.0, lambda: led.has_a_route() and not led.guide.lost)
