"""The way to a pose: a route around what stands, kept up to date while the robot drives."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.core.errors import InputError
from omniman_ros.planning import economy
from omniman_ros.planning.floor import Floor
from omniman_ros.planning.following import Along
from omniman_ros.planning.model import PlanningModel
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.planning.route import LEVER, Route
from omniman_ros.planning.route_search import RouteSearch

Array = NDArray[np.float64]

RATE = 0.9
"""Share of the acceleration limits at which targets speed up and slow down."""
EASE = 0.65
"""Largest speed of a short way, over the speed at which it would take the least time: a tenth
more of time, and a third less of energy beyond friction's."""
STANDING = 0.1
"""Obstacles that are slower than this stand, where a route is concerned [m/s]."""
WORK = 4000
"""What a search does in a cycle of the planner, in expansions: about 8 ms."""
FIRST = 3
"""So many times that while the robot waits for its first route."""
LOOK = 0.5
"""Period at which the rest of a route is checked [s]."""
AGAIN = 2.0
"""After a search that found nothing the next begins so much later [s]."""
STUCK, PROGRESS = 1.5, 0.1
"""A robot that has not come on by so much of a route for so long is stuck [s]."""
TIGHTER = 3
"""Clearances that a search is made with, from the usual one down to the least."""
SLOW, SLOWEST = 0.25, 0.1
"""Paces at which a robot goes on that was stuck twice, and more often."""
FREED, EASED = 1.0, 0.3
"""For so much of a route it does so [s]; that slow, for so much."""
SPARE, BESIDE, WIDE = 0.01, 0.3, 0.2
"""Plans keep so much less than the gaps of the route [m], from so much before the robot to so
much after the plan [s]; gaps above that are wide [m]."""
TOO_CLOSE = 0.01
"""A route that comes closer to anything is no longer clear [m]."""
AHEAD = 0.05
"""Over so much of a route the pace is measured [s]."""


class Guide:
    """Leads to a pose along a route, and looks for another where it is not clear any more.

    Open floor is crossed on the straight line, turned into the heading that takes the least
    energy; where that is not clear, without the turn; else a search finds the way.

    Args:
        model: The robot.
        goal: (3,) pose in odom [m, m, rad].

    Attributes:
        goal: Where to.
        route: How, or None before the first look.
        lost: Why the last search found nothing, or empty.
    """

    def __init__(self, model: PlanningModel, goal: Array) -> None:
        self._model = model
        self.goal = goal
        self.route: Route | None = None
        self.lost = ""
        self._direct = True
        self._room = np.array([[0.0], [math.inf]])
        self._place = 0.0
        self._search: RouteSearch | None = None
        self._searches: Iterator[RouteSearch] = iter(())
        self._asked = math.nan
        self._due = -math.inf
        self._looked = -math.inf
        self._came = math.inf, 0.0
        self._tries = 0

    @property
    def state(self) -> str:
        """What it does, for people."""
        if self._search is not None:
            return "searches"
        return "a straight line" if self._direct else "a route"

    @property
    def left(self) -> float:
        """What is left of the route, at its speeds [s]; 0 without one."""
        return 0.0 if self.route is None else self.route.duration - self._place

    @property
    def waiting(self) -> bool:
        """Whether the first search is not done yet: nobody knows where to go."""
        return self.route is None and self._search is not None

    @property
    def hindered(self) -> bool:
        """Whether the robot was stuck a short way back."""
        return self._tries > 0

    def stuck(self, now: float) -> bool:
        """Whether the robot has not come on for a while."""
        return now > self._came[0] + STUCK

    # ---- for the next plan --------------------------------------------------------------------

    def along(self, start: Array, due: float, p: PlannerParameters, share: float) -> Along:
        """Targets from a state (6,) on that the robot has when an answer is due [s]."""
        if self.route is None:  # nobody looked
            self._adopt(self._straight(start[:3], p, share), None, direct=True)
        route = self._timed(p.speeds(share))
        self._place = max(self._place, route.project(start[:3], self._place))
        limits = p.limits
        rate = RATE * min(
            min(limits.linear_acceleration, limits.linear_deceleration) / limits.linear_velocity,
            min(limits.angular_acceleration, limits.angular_deceleration)
            / limits.angular_velocity,
        )
        most = self._slow if self._tries > 1 else min(EASE * math.sqrt(rate * route.duration), 1.0)
        return Along(route, due, self._place, self._pace(route, start), rate, most)

    def clearance(self, p: PlannerParameters) -> float:
        """Gap that the next plan keeps [m]: less than usual only where the route has less."""
        places, gaps = self._room
        ahead = (places >= self._place - BESIDE) & (
            places <= self._place + p.horizon.duration + BESIDE
        )
        room = float(gaps[ahead].min(initial=math.inf)) - SPARE
        return max(min(p.safety.clearance, room), p.safety.least_clearance)

    @property
    def _slow(self) -> float:
        return SLOW if self._tries == 2 else SLOWEST

    def _timed(self, speeds: tuple[float, float]) -> Route:
        """The route at the speeds of now: limits are live."""
        assert self.route is not None
        if self.route.speeds != speeds:
            old, new = self.route, Route(self.route.poses, speeds)
            here = np.array([self._place, self._came[1]])
            place, came = np.interp(here, old.times, new.times).tolist()
            self._place, self._came = place, (self._came[0], came)
            self._room[0] = np.interp(self._room[0], old.times, new.times)
            self.route = new
        return self.route

    def _pace(self, route: Route, start: Array) -> float:
        """How fast a state (6,) moves along the route, in the route's seconds per second."""
        here, there = route.at(np.array([self._place, self._place + AHEAD]))
        size = np.array([1.0, 1.0, LEVER])
        along = size * (there - here) / AHEAD
        velocity = size * se2.to_world(float(start[2]), start[3:])
        return float(velocity @ along) / max(float(along @ along), 1e-6)

    # ---- the route ----------------------------------------------------------------------------

    def look(
        self, now: float, pose: Array, floor: Floor, p: PlannerParameters, share: float, work: int
    ) -> None:
        """Check the rest of the route now and then, and search for another where it is not clear.

        Args:
            now: Time [s].
            pose: (3,) of the robot, its heading on the branch of the motion [m, m, rad].
            floor: What stands, and is to be gone around.
            p: Parameters.
            share: Of the limits that is left.
            work: How much a search may do in this call, in expansions.
        """
        comes_on = self._place > self._came[1] + PROGRESS
        if comes_on or now > self._looked + LOOK:
            self._came = now, self._place
            self.lost = "" if comes_on else self.lost
            if self._place > EASED:
                self._tries = 0 if self._place > FREED else min(self._tries, 2)
        self._looked = now
        try:
            self._look_after(now, pose, floor, p, share, work)
        except InputError as error:  # of numbers that are no place: nothing can be searched
            self.lost, self._search, self._due = str(error), None, now + AGAIN

    def _look_after(
        self, now: float, pose: Array, floor: Floor, p: PlannerParameters, share: float, work: int
    ) -> None:
        if self._search is not None:
            self._go_on(now, floor, FIRST * work if self.waiting else work)
            if self._search is None and self.route is None:  # as near as it gets
                self._adopt(self._straight(pose, p, share), None, direct=True)
        elif self.stuck(now):
            self._tries += not self.lost  # where there is no way, patience finds none
            self._seek(pose, floor, p, share)
        elif now >= self._due:
            self._due = now + LOOK
            self._check(pose, floor, p, share)

    def _check(self, pose: Array, floor: Floor, p: PlannerParameters, share: float) -> None:
        half = self._model.half

        def clear(route: Route, margin: float, first: float = 0.0) -> bool:
            _, poses = route.samples(half, first)
            return bool(floor.gaps(poses, half, margin + SPARE).min() > margin)

        same = self._direct or self._asked == p.safety.clearance
        kept = self.route is not None and same and clear(self.route, TOO_CLOSE, self._place)
        if kept and self._direct:
            self.lost = ""  # of a line that was blocked until now
            return
        turned = self._straight(pose, p, share)
        for line in (turned, Route(turned.poses[[0, -1]], turned.speeds)):
            if clear(line, p.safety.clearance):
                self.lost = ""
                self._adopt(line, None, direct=True)
                return
        if not kept:
            self._seek(pose, floor, p, share)

    def _seek(self, pose: Array, floor: Floor, p: PlannerParameters, share: float) -> None:
        """Begin a search: for a way with the usual clearance, then for ever tighter ones."""
        least, self._asked = p.safety.least_clearance, p.safety.clearance

        def search(margin: float) -> RouteSearch:
            return RouteSearch(
                pose, self.goal, self._model.half, margin, p.speeds(share),
                floor.ellipses, floor.grid, p.workspace.bounds,
            )  # fmt: skip

        margins = np.linspace(self._asked, least, TIGHTER).tolist()
        self._searches = map(search, margins)
        self._search = next(self._searches)

    def _go_on(self, now: float, floor: Floor, work: int) -> None:
        assert self._search is not None
        if not self._search.advance(work):
            return
        route, reason = self._search.route, self._search.reason
        self._search = None if route is not None else next(self._searches, None)
        if self._search is not None:
            return
        self.lost = reason
        self._due = now + (LOOK if route is not None else AGAIN)
        self._came = now, self._place
        if route is not None:
            self._adopt(route, floor, direct=False)

    def _straight(self, pose: Array, p: PlannerParameters, share: float) -> Route:
        """The straight line from a pose (3,), in the heading that takes the least energy."""
        speeds = p.speeds(share)
        goal = np.append(self.goal[:2], pose[2] + se2.wrap(float(self.goal[2] - pose[2])))
        return Route(economy.straight(self._model, pose, goal, speeds), speeds)

    def _adopt(self, route: Route, floor: Floor | None, direct: bool) -> None:
        self._came = self._came[0], self._came[1] - self._place  # what it has come on counts
        self.route, self._direct, self._place = route, direct, 0.0
        self._room = np.array([[0.0], [math.inf]])
        if floor is not None:
            half = self._model.half
            places, poses = route.samples(half)
            self._room = np.stack([places, floor.gaps(poses, half, WIDE)])
