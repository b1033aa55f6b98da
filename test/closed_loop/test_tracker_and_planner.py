"""The planner by the map of the tracker alone: from its start, and after the robot was moved."""

import math

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.parameters import build
from omniman_ros.nodes.mpc_planner.parameters import MpcPlannerParameters
from omniman_ros.perception.obstacle_tracker import ObstacleTracker
from omniman_ros.perception.parameters import MapParameters, TrackerParameters
from omniman_ros.perception.scan import Scan
from omniman_ros.planning.cases import CASES
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.surroundings.grid_map import GridMap
from omniman_ros.surroundings.occupancy import OccupancyMap
from omniman_ros.surroundings.tracking import TrackingParameters
from test import robots
from test.planning.support import CYCLE, SimulatedRun, ellipses, planner

BEAMS = 360
FIELD = 1.5 * math.pi
#: Where the scanner is: what is below the robot and behind it, it does not see
MOUNT = (0.35, 0.0, 0.0)
ROOM = (-2.5, -4.0, 9.0, 3.5)  #: Walls x_min, y_min, x_max, y_max [m]
POSTS = ((1.0, 1.6, 0.2), (3.5, -1.2, 0.2), (-1.5, -2.0, 0.25))
MAP_EVERY = 4  #: Cycles between two maps
RULE = build(MpcPlannerParameters, robots.values("ig42")).map_reading.rule


def ranges_from(x, y, directions):
    """Return the distances of walls and posts (N,) from a place [m]."""
    ux, uy = np.cos(directions), np.sin(directions)
    with np.errstate(divide="ignore"):
        walls = (
            (np.where(ux < 0.0, ROOM[0], ROOM[2]) - x) / ux,
            (np.where(uy < 0.0, ROOM[1], ROOM[3]) - y) / uy,
        )
    found = np.minimum(*walls)
    for px, py, radius in POSTS:
        along, aside = (px - x) * ux + (py - y) * uy, (px - x) * uy - (py - y) * ux
        inside = radius**2 - aside**2
        hit = np.where(inside > 0.0, along - np.sqrt(np.maximum(inside, 0.0)), math.inf)
        found = np.where((hit > 0.0) & (hit < found), hit, found)
    return found


class ScannedRun(SimulatedRun):
    """A robot that sees by a scanner: its tracker gives the planner a map, five times a second."""

    def __init__(self, rule=RULE):
        super().__init__(planner())
        self.rule = rule
        half = self.planner.model.half
        self.own = Footprint(Rectangles.centred(half), (0.0, 0.4))
        self.tracker = ObstacleTracker(
            TrackerParameters(), MapParameters(size=24.0), TrackingParameters()
        )
        self.cycles = 0
        self.look()

    def look(self):
        """Scan once, and take the map to the planner."""
        x, y, theta = self.pose().tolist()
        for at in (self.now - CYCLE, self.now):
            self.tracker.add_pose(at, np.array([x, y, theta]), np.zeros(3))
        step = FIELD / (BEAMS - 1)
        directions = theta - 0.5 * FIELD + step * np.arange(BEAMS)
        sx, sy = x + MOUNT[0] * math.cos(theta), y + MOUNT[0] * math.sin(theta)
        ranges = ranges_from(sx, sy, directions)
        scan = Scan(self.now, ranges, -0.5 * FIELD, step, 20.0, MOUNT, 0.0, (0.2, 0.2))
        self.tracker.add_scan(scan, self.own)
        if self.cycles % MAP_EVERY == 0:
            cells = self.tracker.occupancy()
            local = self.tracker.map
            origin = np.append(local.origin, 0.0)
            occupancy = OccupancyMap(cells, local.resolution, origin)
            self.planner.set_map(GridMap.of_occupancy(occupancy, *self.rule))
        self.cycles += 1

    def cycle(self, solving=0.01):
        super().cycle(solving)
        self.look()

    def relocate(self, pose):
        """Move the robot as the page does: plant and odometry, at rest and without a goal."""
        self.planner.abort(self.now - 1.0, None)
        self._last, self._followed, self.offset = np.array(pose, float), False, np.zeros(3)
        for _ in range(MAP_EVERY + 2):
            self.now += CYCLE
            self.look()

    def reach(self, pose, seconds):
        """Drive to a goal, and assert that the robot was never blocked."""
        self.states.clear()
        self.drive(PoseGoal(np.array(pose, float)))
        self.run(seconds)
        assert self.planner.state is PlannerState.ARRIVED, self.planner.blocked_by
        assert PlannerState.BLOCKED not in self.states


@pytest.mark.parametrize("rule", [RULE, (50, False)])
def test_the_first_goal_after_the_start_is_reached_by_the_map_of_a_scanner_alone(rule):
    run = ScannedRun(rule)
    run.reach((0.8, 0.3, 0.3), 8.0)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", list(CASES))
def test_the_cases_of_the_page_are_driven_after_other_drives_and_after_a_restart(name):
    case = CASES[name]
    run = ScannedRun()
    run.reach((0.4, -0.3, 1.57), 8.0)
    for _ in range(2):
        run.relocate(case.start)
        begin = run.now

        def seen(now, begin=begin):
            rows = [(*path(now - begin).tolist(), case.radius) for path in case.paths]
            speeds = [path.speed(now - begin) for path in case.paths]
            return ellipses(*rows, time=now, velocities=speeds)

        run.seen = seen
        run.reach(case.goal, 40.0)
