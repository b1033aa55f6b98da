"""Decision whether a collision-free path exists, by exhaustive search over x, y, heading and time.

The search knows the true motion of all obstacles and shares no code with the planner that it
judges. The robot is a box that translates in any direction up to a speed and rotates up to a yaw
rate; its accelerations are not limited.

The nodes of a grid over x, y and heading that the robot can reach form a layer. The next layer, a
step later, contains the nodes that the robot can reach from these in a step, without the nodes
that are too near to an obstacle. A bit represents a node; the bits of a word are its headings.

A path that is found is free of contact between the nodes, too. Let q be the distance that any
point of the box travels in a step relative to an obstacle, and b = R delta^2 / 8 its largest
distance from its chord in a rotation by delta, where R is the distance of the corners from the
centre. Nodes keep a gap m, which is larger than

* sqrt((r + b)^2 + (q / 2)^2) - r for an ellipse whose smallest radius of curvature is r. The
  ellipse is a smaller convex body with a disc of radius r rolled around it. The point of the box
  nearest to a point of that body has a distance of r + m from it at both ends, and moves by at
  most q.
* the same with r = 0 for a wall, if the robot rotates and drives in one step.
* l / sqrt(8) for a wall along which the robot drives by l without rotation: the area that its
  centre must not enter contains a box of the robot's size around each of its points. A chord
  between two points that far from a right angle does not reach it; one across the box is longer
  than its width and 2 m.
* half the travel for a rotation in place beside a wall.

The search may miss paths whose gap is less than the gap that nodes keep plus the rounding of the
grid (`Grid.spare`), and paths that need more than 0.89 of the speed in some direction, or that
rotate as fast as possible while they drive along a wall.
"""

import math
from collections.abc import Sequence

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.lab.studies.scene_geometry import Wall, World
from omniman_ros.lab.studies.scene_judge import judge
from omniman_ros.lab.studies.space_time_grid import GRIDS, Grid, Mover
from omniman_ros.lab.studies.space_time_nodes import SearchNodes
from omniman_ros.lab.studies.space_time_reach import ReachSearch, Way

SURROUNDINGS = 1.5
"""Distance around start, goal and fixed bodies that is searched if no area is given [m]."""


def find_way(
    mover: Mover,
    world: World,
    start: Sequence[float],
    goal: Sequence[float],
    since: float,
    until: float,
    grids: Sequence[Grid] = GRIDS,
) -> Way | None:
    """Find a path from start to goal without contact.

    Args:
        mover: The robot.
        world: Obstacles, walls and area. All of the robot stays in the area; without one, its
            centre stays within `SURROUNDINGS`.
        start: (3,) pose at the time `since` in odom [m, m, rad].
        goal: (3,) pose to reach at any time up to `until` in odom [m, m, rad].
        since: Begin of the search [s].
        until: End of the search [s].
        grids: Grids, tried in turn.

    Returns:
        The path, whose last pose is the goal; None if none was found.

    Raises:
        InputError: A pose is not finite, or the times are not in order.
    """
    begin, end = _pose("start", start), _pose("goal", goal)
    _span(since, until)
    places = [begin[:2], end[:2]] + [o.place(since) for o in world.obstacles if o.fixed]
    places += [np.array((w.x, w.y)) + s for w in world.walls for s in _corners(w)]
    low, high = np.min(places, axis=0) - SURROUNDINGS, np.max(places, axis=0) + SURROUNDINGS
    # Fixed obstacles at the start or the goal rule out any path.
    fixed = World(tuple(o for o in world.obstacles if o.fixed), world.walls, world.area)
    for pose in (begin, end):
        verdict = judge(np.array([since]), pose[None], mover.box, fixed)
        if verdict.collided or verdict.outside > 0.0:
            return None
    for grid in grids:
        nodes = SearchNodes(mover, world, begin, since, until, grid, (*low, *high))
        path = ReachSearch(nodes).run(end)
        if path is not None:
            return path
    return None


def escape(
    mover: Mover,
    world: World,
    start: Sequence[float],
    since: float,
    until: float,
    grids: Sequence[Grid] = GRIDS,
) -> Way | None:
    """Find a path without contact from a pose at one time until another time.

    Args:
        mover: The robot.
        world: Obstacles, walls and area. All of the robot stays in the area, if there is one: a
            robot that is not within it finds no path.
        start: (3,) pose at the time `since` in odom [m, m, rad].
        since: Begin of the search [s].
        until: End of the search [s].
        grids: Grids, tried in turn.

    Returns:
        The path; None if none was found.

    Raises:
        InputError: The pose is not finite, or the times are not in order.
    """
    begin = _pose("start", start)
    _span(since, until)
    if judge(np.array([since]), begin[None], mover.box, world).collided:
        return None
    reach = mover.speed * (until - since) + 1.0
    bounds = (begin[0] - reach, begin[1] - reach, begin[0] + reach, begin[1] + reach)
    for grid in grids:
        path = ReachSearch(SearchNodes(mover, world, begin, since, until, grid, bounds)).run()
        if path is not None:
            return path
    return None


def avoidable(
    mover: Mover,
    world: World,
    times: Array,
    poses: Array,
    contact: float,
    before: float = 2.0,
    after: float = 1.0,
    grids: Sequence[Grid] = GRIDS,
) -> Way | None:
    """Find a path by which a robot that knew the future could have avoided a contact.

    The robot's velocity when the search begins is ignored, as accelerations are not limited; lower
    the mover's speed to allow for braking.

    Args:
        mover: The robot.
        world: Obstacles, walls and area.
        times: (K,) times of the drive [s], increasing.
        poses: (K, 3) true poses of the drive in odom [m, m, rad].
        contact: Time of the drive's first contact [s].
        before: Time before the contact at which the search begins, or with the drive if that is
            later [s].
        after: Time after the contact for which the path is free of contact, too [s].
        grids: Grids, tried in turn.

    Returns:
        The path; None if none was found, and then the contact is not the robot's fault.

    Raises:
        InputError: The contact is not within the drive, or a pose is not finite.
    """
    if not times[0] <= contact <= times[-1]:
        raise InputError(
            f"the contact at {contact} s is not within the drive, {times[0]} to {times[-1]} s"
        )
    since = max(contact - before, float(times[0]))
    headings = np.unwrap(poses[:, 2])
    pose = [float(np.interp(since, times, i)) for i in (poses[:, 0], poses[:, 1], headings)]
    return escape(mover, world, pose, since, contact + after, grids)


def _pose(name: str, pose: Sequence[float]) -> Array:
    """Return a pose as an array (3,), after a check."""
    result = np.array(pose, dtype=float)
    if result.shape != (3,) or not np.isfinite(result).all():
        raise InputError(f"the {name} must be a finite x, y, heading, got {pose}")
    return result


def _span(since: float, until: float) -> None:
    """Check that two times [s] are finite and in order."""
    if not (math.isfinite(since) and math.isfinite(until) and since < until):
        raise InputError(f"a search must end after it begins, got {since} to {until} s")


def _corners(wall: Wall) -> list[Array]:
    """Return the corners (2,) of a wall relative to its centre [m]."""
    c, s = math.cos(wall.heading), math.sin(wall.heading)
    along, across = 0.5 * wall.length, 0.5 * wall.width
    return [
        np.array((i * along * c - j * across * s, i * along * s + j * across * c))
        for i in (-1, 1)
        for j in (-1, 1)
    ]
