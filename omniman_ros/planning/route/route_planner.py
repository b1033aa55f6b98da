"""Planning of the route to a pose around static obstacles, updated while the robot drives."""

import math
from collections.abc import Iterator
from enum import Enum

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.obstacles.environment import Environment
from omniman_ros.planning.obstacles.escape_path import EscapePath
from omniman_ros.planning.route import energy_saving
from omniman_ros.planning.route.problem import RouteProblem
from omniman_ros.planning.route.route import HEADING_ERROR_LENGTH, Route, straight
from omniman_ros.planning.route.route_goal import RouteGoal
from omniman_ros.planning.route.search import RouteSearch
from omniman_ros.planning.route.sight import is_seen, seen_until

#: Factor on the acceleration limits at which the targets accelerate and decelerate [-]
PACE_RATE_FACTOR = 0.9
#: Ratio of the largest pace on a short route to the pace of the shortest time [-].
#:
#: The route then needs a tenth more time, and a third less energy in addition to that of friction.
SHORT_ROUTE_PACE = 0.65
STATIC_SPEED = 0.1  #: Speed below which a route leads around an obstacle [m/s]
SEARCH_WORK = 4000  #: Work of a search in one planning cycle [expansions]: about 8 ms
#: Factor on the work of a search while the robot waits for its first route [-]
FIRST_SEARCH_FACTOR = 3
CHECK_PERIOD = 0.5  #: Period at which the whole rest of the route is checked [s]
#: Part of the route ahead of the robot that is checked in each cycle [s]
CHECKED_AHEAD = 2.5
#: Gap at the place from which a search begins, where there is one so wide [m]
SEARCH_GAP = 0.1
#: Time after which a search counts as finished where the place is chosen from which it begins [s]
SEARCH_TIME = 0.6
RETRY_DELAY = 2.0  #: Time from a search without a result to the next search [s]
STUCK_TIME = 1.5  #: Time without progress after which the robot counts as stuck [s]
STUCK_PROGRESS = 0.1  #: Progress along the route that counts as progress [s of the route]
#: Number of clearances with which routes are searched, from the usual one down to the smallest
CLEARANCES = 3
SECOND_TRY_PACE = 0.25  #: Largest pace of a robot that was stuck twice [-]
LATER_TRY_PACE = 0.1  #: Largest pace of a robot that was stuck more often [-]
#: Position on the new route from which the robot drives at the usual pace again [s]
SLOW_DISTANCE = 1.0
#: Position on the new route up to which LATER_TRY_PACE holds; then SECOND_TRY_PACE does [s]
SLOWEST_DISTANCE = 0.3
#: Difference between the gap of the route and the smaller one that plans keep [m]
GAP_RESERVE = 0.01
#: Extent of the window, before the robot and after the plan, in which gaps count [s]
GAP_WINDOW = 0.3
WIDE_GAP = 0.2  #: Gap above which gaps of the route are not distinguished [m]
MIN_KEPT_GAP = 0.01  #: Gap at which the rest of a route still counts as clear [m]
#: Difference from the gap at its adoption above which a narrower route is no longer clear [m]
GAP_CHANGE = 0.005
#: Distance from the end of the route to a goal that moved, up to which the route is bent [m]
MAX_BEND = 0.05
#: Distance from the end of the route to a goal that moved, below which it stays [m]
MIN_BEND = 1e-4
#: Part of the route after the robot to which targets lead, though it is hidden [s]
LEAST_SIGHT = 0.2
#: Distance from the route above which the robot has left it, if an obstacle is between [m]
LEFT_ROUTE = 0.3
PACE_SPAN = 0.05  #: Part of the route over which the pace of the robot is measured [s]


class RouteSource(Enum):
    """Source of the plans' targets; the values are those of `led_by` in `mpc/status`."""

    GOAL = "the goal"
    SEARCH = "searches"
    STRAIGHT_LINE = "a straight line"
    ROUTE = "a route"
    ESCAPE_PATH = "the way out of what it touches"
    REST = "nothing"


class RoutePlanner:
    """Plans a route to a pose, and another one when it is no longer clear.

    On free ground the route is the straight line, driven in the heading that requires the least
    energy. If that is not clear, it is the straight line without the rotation to that heading;
    otherwise it is the result of a search. A robot that touches something first leaves it, by the
    way out. Where there is no route, the robot comes to rest and stays, until there is one.

    A search begins on the part of the old route that is still clear, where the robot will be when
    it is finished. The robot is led no farther than that place, where the new route is joined.
    While something stands on the goal, the robot drives up to it and waits, without a search.

    Attributes:
        goal: Pose (3,) in odom that the route leads to [m, m, rad].
        failure: What is in the way and why the last search found no route, or an empty string.
        escape_path: Way on which the robot leaves what it touches, or None.
        is_trapped: Whether the robot touches something, and no way leads out.
    """

    def __init__(self, model: PlanningModel, goal: Array) -> None:
        self._model = model
        self.goal = goal
        self.route: Route | None = None
        self.failure = ""
        self.escape_path: EscapePath | None = None
        self.is_trapped = False
        self._kind = RouteSource.STRAIGHT_LINE
        self._gaps = np.array([[0.0], [math.inf]])
        self._position = 0.0
        self._hold = math.inf
        self._around: Environment | None = None
        self._ahead = 0.0
        self._search: RouteSearch | None = None
        self._searches: Iterator[RouteSearch] = iter(())
        self._searched_clearance = math.nan
        self._next_check = -math.inf
        self._updated = -math.inf
        self._progress = math.inf, 0.0
        self._tries = 0

    @property
    def source(self) -> RouteSource:
        """Source of the route."""
        if self._search is not None:
            return RouteSource.SEARCH
        return self._kind

    @property
    def remaining(self) -> float:
        """Duration of the rest of the route at its speeds [s]; 0 without a route."""
        return 0.0 if self.route is None else self.route.duration - self._position

    @property
    def remaining_length(self) -> float:
        """Length of the rest of the route [m]; 0 without a route."""
        return 0.0 if self.route is None else self.route.length_from(self._position)

    @property
    def is_waiting(self) -> bool:
        """Whether the first search is not finished, so that no route is known yet."""
        return self.route is None and self._search is not None

    @property
    def was_stuck(self) -> bool:
        """Whether the robot was stuck shortly before on its route."""
        return self._tries > 0

    def is_stuck(self, now: float) -> bool:
        """Return whether the robot has made no progress on its route for STUCK_TIME."""
        return self._kind is not RouteSource.REST and now > self._progress[0] + STUCK_TIME

    def follows(self, goal: Array) -> bool:
        """Lead to a goal (3,) that has moved; return whether that needs no other route.

        Up to MAX_BEND, the route is bent: its end moves with the goal, its start stays. While a
        search is under way, the route that it finds is bent later.
        """
        leads = self._kind in (RouteSource.STRAIGHT_LINE, RouteSource.ROUTE)
        end = self.route.poses[-1] if leads and self.route is not None else self.goal
        shift = goal - end
        shift[2] = se2.wrap(float(shift[2]))
        size = math.hypot(*shift[:2]) + HEADING_ERROR_LENGTH * abs(float(shift[2]))
        if size > MAX_BEND:
            return False
        if self._search is not None or size <= MIN_BEND:
            return True
        if not leads:
            self.goal = goal
        elif self.route is not None:
            self.goal, route = goal, self.route
            fraction = route.times / route.duration if route.duration > 0.0 else np.ones(1)
            self._retime(Route(route.poses + fraction[:, None] * shift, route.speeds))
        return True

    def restarted(self, goal: Array) -> "RoutePlanner":
        """Return a planner of the route of the same robot to another goal (3,)."""
        return RoutePlanner(self._model, goal)

    # ---- for the next plan --------------------------------------------------------------------

    def goal_from(self, start: Array, due: float, limits: EffectiveLimits) -> RouteGoal:
        """Return the goal of the plan that begins at a state (6,) at the time `due` [s]."""
        if self.route is None:
            if self.failure:
                self._adopt(_rest(start, limits), None, RouteSource.REST)
            else:  # there was no update
                self._adopt(self._straight(start[:3], limits), None, RouteSource.STRAIGHT_LINE)
        route = self._timed(limits.speeds)
        self._position = max(self._position, route.project(start[:3], self._position))
        full = limits.parameters.limits
        rate = PACE_RATE_FACTOR * min(
            min(full.linear_acceleration, full.linear_deceleration) / full.linear_velocity,
            min(full.angular_acceleration, full.angular_deceleration) / full.angular_velocity,
        )
        pace = self._pace(route, start)
        # The robot may accelerate until a search is finished, and brakes then.
        top = min(max(pace, 0.0) + rate * SEARCH_TIME, 1.0)
        self._ahead = 0.5 * (pace + top) * SEARCH_TIME + 0.5 * top * top / rate
        if self._kind is RouteSource.ESCAPE_PATH:
            max_pace = SECOND_TRY_PACE
        elif self._tries > 1:
            max_pace = SECOND_TRY_PACE if self._tries == 2 else LATER_TRY_PACE
        else:
            max_pace = min(SHORT_ROUTE_PACE * math.sqrt(rate * route.duration), 1.0)
        last = self._hold
        if self._around is not None and self._leads:
            seen = seen_until(route, self._position, start[:2], self._around)
            last = min(last, max(seen, self._position + LEAST_SIGHT))
        if last < route.duration:
            route = route.between(0.0, max(last, self._position))
        return RouteGoal(route, due, self._position, pace, rate, max_pace)

    def ahead(self, span: float) -> Array:
        """Return the pose (3,) a span [s] ahead on the route, or at the end of a straight one."""
        if self.route is None:
            return self.goal
        is_straight = self._kind is RouteSource.STRAIGHT_LINE
        position = self.route.duration if is_straight else self._position + span
        pose: Array = self.route.at(np.array([position]))[0]
        return pose

    def clearance(self, limits: EffectiveLimits) -> float:
        """Return the clearance of the next plan [m], reduced where the route's gap is small."""
        p = limits.parameters
        positions, gaps = self._gaps
        ahead = (positions >= self._position - GAP_WINDOW) & (
            positions <= self._position + p.horizon.duration + GAP_WINDOW
        )
        gap = float(gaps[ahead].min(initial=math.inf)) - GAP_RESERVE
        return max(min(p.safety.clearance, gap), p.safety.least_clearance)

    def _timed(self, speeds: tuple[float, float]) -> Route:
        """Return the route at other speeds [m/s, rad/s], as limits may change at any time."""
        assert self.route is not None
        if self.route.speeds != speeds:
            self._retime(Route(self.route.poses, speeds))
        return self.route

    def _retime(self, new: Route) -> None:
        """Replace the route by one with as many poses, and keep the place on it."""
        assert self.route is not None
        old = self.route
        here = np.array([self._position, self._progress[1], self._hold])
        position, reached, hold = np.interp(here, old.times, new.times).tolist()
        self._position, self._progress = position, (self._progress[0], reached)
        self._hold = hold if self._hold < math.inf else math.inf
        self._gaps[0] = np.interp(self._gaps[0], old.times, new.times)
        self.route = new

    def _pace(self, route: Route, start: Array) -> float:
        """Return the pace of a state (6,) along the route [s of the route per s]."""
        here, there = route.at(np.array([self._position, self._position + PACE_SPAN]))
        size = np.array([1.0, 1.0, HEADING_ERROR_LENGTH])
        along = size * (there - here) / PACE_SPAN
        velocity = size * se2.to_world(float(start[2]), start[3:])
        return float(velocity @ along) / max(float(along @ along), 1e-6)

    # ---- the route ----------------------------------------------------------------------------

    def update(
        self,
        now: float,
        pose: Array,
        environment: Environment,
        limits: EffectiveLimits,
        work: int,
    ) -> None:
        """Check the rest of the route periodically, and search for another if it is not clear.

        The heading of the pose is on the branch of the motion; the work is limited [expansions].

        Args:
            pose: (3,) pose of the robot, its heading on the branch of the motion [m, m, rad].
        """
        progresses = self._position > self._progress[1] + STUCK_PROGRESS
        if progresses or now > self._updated + CHECK_PERIOD:
            self._progress = now, self._position
            self.failure = "" if progresses else self.failure
            if self._position > SLOWEST_DISTANCE:
                self._tries = 0 if self._position > SLOW_DISTANCE else min(self._tries, 2)
        self._updated, self._around = now, environment
        try:
            self._advance(now, pose, environment, limits, work)
        except InputError as error:  # a pose is not finite: no search is possible
            self._search = None
            self._fail(now, str(error))

    def _advance(
        self,
        now: float,
        pose: Array,
        environment: Environment,
        limits: EffectiveLimits,
        work: int,
    ) -> None:
        """Continue the search, begin one if the robot is stuck, or check the route if due."""
        if self._search is not None:
            work = FIRST_SEARCH_FACTOR * work if self.is_waiting else work
            self._continue_search(now, pose, environment, work)
        elif self.is_stuck(now):
            self._tries += not self.failure  # a slower try does not help if there is no route
            self._begin_search(now, pose, environment, limits)
        elif self._has_left(pose, environment):
            self._begin_search(now, pose, environment, limits)
        elif now >= self._next_check or not self._is_clear_ahead(environment):
            self._next_check = now + CHECK_PERIOD
            self._check(now, pose, environment, limits)

    @property
    def _leads(self) -> bool:
        """Whether the robot follows a route to the goal."""
        return self.route is not None and self._kind in (
            RouteSource.STRAIGHT_LINE,
            RouteSource.ROUTE,
        )

    def _has_left(self, pose: Array, environment: Environment) -> bool:
        """Return whether an obstacle is between the robot and its route."""
        if not self._leads or self.route is None:
            return False
        place = self.route.at(np.array([self._position]))[0, :2]
        is_far = math.dist(place.tolist(), pose[:2].tolist()) > LEFT_ROUTE
        return is_far and not is_seen(pose[:2], place, environment)

    def _is_clear_ahead(self, environment: Environment) -> bool:
        """Return whether the next part of a route to the goal is clear; True without one."""
        if not self._leads:
            return True
        last = min(self._position + CHECKED_AHEAD, self._hold)
        return self._clear_until(environment, last)[0] == math.inf

    def _clear_until(
        self, environment: Environment, last: float = math.inf
    ) -> tuple[float, Array, Array]:
        """Return the position [s] at which the rest of the route ceases to be clear, or infinity.

        It is searched up to a position `last` [s]. A route that was narrower from the beginning
        is clear as long as it does not get narrower. Also returned are positions (K,) [s] and gaps
        (K,) [m] there.
        """
        assert self.route is not None
        positions, poses = self.route.samples(environment.footprint.radius, self._position, last)
        gaps = environment.gaps(poses, WIDE_GAP)
        kept = np.clip(np.interp(positions, *self._gaps) - GAP_CHANGE, 0.0, MIN_KEPT_GAP)
        blocked = gaps <= kept
        until = float(positions[int(blocked.argmax())]) if blocked.any() else math.inf
        return until, positions, gaps

    def _check(
        self, now: float, pose: Array, environment: Environment, limits: EffectiveLimits
    ) -> None:
        """Keep the route if it is clear; else use a clear straight line, or begin a search."""
        radius, safety = environment.footprint.radius, limits.parameters.safety

        def is_clear(route: Route, margin: float) -> bool:
            _, poses = route.samples(radius)
            return bool(environment.gaps(poses, margin + GAP_RESERVE).min() > margin)

        is_direct = self._kind is RouteSource.STRAIGHT_LINE
        is_route = self._kind is RouteSource.ROUTE
        same = is_direct or (is_route and self._searched_clearance == safety.clearance)
        kept = self._leads and same and self._clear_until(environment)[0] == math.inf
        self._hold = math.inf if kept else self._hold
        if kept and is_direct:
            return
        if self._kind is RouteSource.REST:  # time at rest is not time without progress
            self._progress = now, self._position
        economical = self._straight(pose, limits)
        for line in (economical, Route(economical.poses[[0, -1]], economical.speeds)):
            if is_clear(line, safety.clearance):
                self.failure = ""
                self._adopt(line, None, RouteSource.STRAIGHT_LINE)
                return
        if kept:
            return
        place = self._place_ahead(environment)
        if place < math.inf and environment.touches(self.goal):  # no search leads there
            self._hold, self._progress = place, (now, self._position)
        else:
            self._begin_search(now, pose, environment, limits, place)

    def _place_ahead(self, environment: Environment) -> float:
        """Return the position on the route [s] from which to search; infinity if none is ahead.

        The robot can come to rest there after the search, and everything up to it is clear. From a
        route on which it has made no progress, no other one is sought: it may never do.
        """
        if not self._leads or self._position < STUCK_PROGRESS:
            return math.inf
        until, positions, gaps = self._clear_until(environment)
        near = positions <= min(self._position + self._ahead, until - 1e-9)
        if not near.any():
            return math.inf
        roomy = near & (gaps > SEARCH_GAP)
        return float(positions[roomy if roomy.any() else near][-1])

    def _begin_search(
        self,
        now: float,
        pose: Array,
        environment: Environment,
        limits: EffectiveLimits,
        place: float = math.inf,
    ) -> None:
        """Begin a search with the usual clearance; smaller ones follow if it finds no route.

        It begins at the pose of the robot, or at a place on the route [s] if that is finite. A
        robot that touches something leaves it first, or stays where no way leads out.
        """
        self.is_trapped, self._hold = False, math.inf
        if environment.touches(pose):
            self._leave(now, pose, environment, limits)
            return
        if self.route is not None and place < math.inf:
            self._hold, pose = place, self.route.at(np.array([place]))[0]
        p = limits.parameters
        least, self._searched_clearance = p.safety.least_clearance, p.safety.clearance

        def search(margin: float) -> RouteSearch:
            return RouteSearch(
                RouteProblem(
                    pose,
                    self.goal,
                    environment.footprint,
                    margin,
                    limits.speeds,
                    environment.ellipses,
                    environment.grid,
                    p.workspace.bounds,
                )
            )

        margins = np.linspace(self._searched_clearance, least, CLEARANCES).tolist()
        self._searches = map(search, margins)
        self._search = next(self._searches)

    def _leave(
        self, now: float, pose: Array, environment: Environment, limits: EffectiveLimits
    ) -> None:
        """Lead out of what the robot touches, or have it stay and say what that is."""
        way = EscapePath.find(pose, environment)
        self._progress = now, self._position
        self.is_trapped = way is None
        if way is None:
            self._fail(now, f"{environment.nearest(pose)} is where the robot is: no way out")
            return
        self.failure, self._next_check = "", now + CHECK_PERIOD
        self._adopt(
            Route(np.stack([way.start, way.end]), limits.speeds), None, RouteSource.ESCAPE_PATH
        )
        self.escape_path = way

    def _fail(self, now: float, reason: str) -> None:
        """Have the robot come to rest and stay, because there is no route."""
        self.failure, self._next_check = reason, now + RETRY_DELAY
        self._hold = math.inf
        if self._kind is not RouteSource.REST:
            self.route, self.escape_path, self._kind = None, None, RouteSource.REST

    def _continue_search(
        self, now: float, pose: Array, environment: Environment, work: int
    ) -> None:
        """Continue the search, and use its route or begin the next search once it is finished."""
        assert self._search is not None
        if not self._search.advance(work):
            return
        route, reason = self._search.route, self._search.reason
        self._search = None if route is not None else next(self._searches, None)
        if self._search is not None:
            return
        self._progress = now, self._position
        if route is not None and self.route is not None and self._hold < math.inf:
            before = self.route.between(self._position, max(self._hold, self._position))
            route = Route(np.vstack([before.poses[:-1], route.poses]), route.speeds)
        if route is None:
            self._fail(now, f"{self._blocking(pose, environment)}: {reason}")
            return
        self.failure, self._next_check = "", now + CHECK_PERIOD
        self._adopt(route, environment, RouteSource.ROUTE)

    def _blocking(self, pose: Array, environment: Environment) -> str:
        """Return what is at the goal or, if nothing is, in the way to it first."""
        if environment.touches(self.goal):
            return f"{environment.nearest(self.goal)} is at the goal"
        line = straight(pose, self.goal, (1.0, 1.0))
        return _first_within(MIN_KEPT_GAP, line, 0.0, environment) or environment.nearest(pose)

    def obstruction(self, environment: Environment, gap: float) -> str:
        """Return what is nearer than a gap [m] to the rest of the route first, or nothing."""
        if self.route is None:
            return ""
        return _first_within(gap, self.route, self._position, environment)

    def _straight(self, pose: Array, limits: EffectiveLimits) -> Route:
        """Return the line from a pose (3,), in the heading that requires the least energy."""
        speeds = limits.speeds
        goal = np.append(self.goal[:2], pose[2] + se2.wrap(float(self.goal[2] - pose[2])))
        return Route(energy_saving.straight(self._model, pose, goal, speeds), speeds)

    def _adopt(self, route: Route, environment: Environment | None, kind: RouteSource) -> None:
        """Use a route from its start on; its gaps are computed if an environment is given."""
        # The progress along the last route is kept.
        self._progress = self._progress[0], self._progress[1] - self._position
        self.route, self._kind, self._position, self.escape_path = route, kind, 0.0, None
        self._hold = math.inf
        self.is_trapped = self.is_trapped and kind is RouteSource.REST
        self._gaps = np.array([[0.0], [math.inf]])
        if environment is not None:
            positions, poses = route.samples(environment.footprint.radius)
            self._gaps = np.stack([positions, environment.gaps(poses, WIDE_GAP)])


def _first_within(gap: float, route: Route, position: float, environment: Environment) -> str:
    """Return what is nearer than a gap [m] to a route first from a position [s] on, or nothing."""
    _, poses = route.samples(environment.footprint.radius, position)
    near = environment.gaps(poses, WIDE_GAP) <= gap
    return f"{environment.nearest(poses[int(near.argmax())])} is in the way" if near.any() else ""


def _rest(start: Array, limits: EffectiveLimits) -> Route:
    """Return the route of one pose, at which the robot comes to rest from a state (6,)."""
    velocity = se2.to_world(float(start[2]), start[3:])
    linear, angular = limits.decelerations
    times = 0.5 * np.array([math.hypot(*velocity[:2]) / linear, abs(velocity[2]) / angular])
    return Route((start[:3] + velocity * times[[0, 0, 1]])[None], limits.speeds)
