"""Decision whether a collision-free path exists, by exhaustive search over x, y, heading and time.

The search knows the true motion of all obstacles and shares no code with the planner that it
judges. The robot is a box that translates in any direction up to a speed and rotates up to a yaw
rate; its accelerations are not limited.

The search proceeds in layers, each of which belongs to one time and contains the reachable nodes
of a grid over x, y and heading. The next layer, a step later, contains the nodes that the robot
can reach from these in one step, except for those that are too near to an obstacle. Each node is
represented by one bit of a word, whose bits are the headings at one position.

A path that is found is free of contact between the nodes, too. Let q be the longest distance that
a point of the box travels in a step relative to an obstacle, and b = R delta^2 / 8 its largest
distance from its chord in a rotation by delta, where R is the distance of the corners from the
centre. Nodes keep a gap m, which is larger than

* sqrt((r + b)^2 + (q / 2)^2) - r for an ellipse whose smallest radius of curvature is r. The
  ellipse is the Minkowski sum of a smaller convex body and a disc of radius r. The point of the
  box nearest to a point of that body has a distance of at least r + m from it at both ends of the
  step, and moves by at most q.
* the same with r = 0 for a wall, if the robot rotates and drives in one step.
* l / sqrt(8) for a wall past which the robot drives a distance l without rotation. The area that
  the robot's centre must not enter is a union of boxes of the robot's size, so its corners are
  right angles or wider. A chord of length l whose ends keep this distance from the sides of a
  right angle does not cut it off, and a chord across a box would be longer than the width of the
  box plus 2 m.
* half the travel of a corner for a rotation in place beside a wall.

The search may miss paths whose gap is smaller than the gap that nodes keep plus the rounding of
the grid (`Grid.sufficient_gap`), paths that require more than 0.89 of the largest speed in some
direction, and paths that rotate as fast as possible while they lead along a wall.
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
from omniman_ros.lab.studies.space_time_reach import ReachSearch, TimedPath

SURROUNDINGS = 1.5
"""Distance around start, goal and fixed bodies that is searched if no area is given [m]."""


def find_path(
    mover: Mover,
    world: World,
    start: Sequence[float],
    goal: Sequence[float],
    since: float,
    until: float,
    grids: Sequence[Grid] = GRIDS,
) -> TimedPath | None:
    """Find a path from start to goal without contact.

    Args:
        mover: The robot.
        world: Obstacles, walls and area. The whole robot stays in the area; if there is none, its
            centre stays within `SURROUNDINGS` of start, goal and fixed bodies.
        start: (3,) pose at the time `since` in odom [m, m, rad].
        goal: (3,) pose to reach at any time up to `until` in odom [m, m, rad].
        since: Time at which the path begins [s].
        until: Time at which the path ends at the latest [s].
        grids: Grids, which are tried one after the other.

    Returns:
        The path, whose last pose is the goal; None if none was found.

    Raises:
        InputError: A pose is not finite, or the times are not in order.
    """
    begin, end = _pose("start", start), _pose("goal", goal)
    _check_times(since, until)
    places = [begin[:2], end[:2]] + [o.place(since) for o in world.obstacles if o.fixed]
    places += [np.array((w.x, w.y)) + s for w in world.walls for s in _corners(w)]
    low, high = np.min(places, axis=0) - SURROUNDINGS, np.max(places, axis=0) + SURROUNDINGS
    # A fixed body at the start or at the goal rules out any path.
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


def find_escape(
    mover: Mover,
    world: World,
    start: Sequence[float],
    since: float,
    until: float,
    grids: Sequence[Grid] = GRIDS,
) -> TimedPath | None:
    """Find a path without contact from a pose to anywhere, which lasts until a given time.

    Args:
        mover: The robot.
        world: Obstacles, walls and area. The whole robot stays in the area, if there is one: for
            a robot that is not within it, no path is found.
        start: (3,) pose at the time `since` in odom [m, m, rad].
        since: Time at which the path begins [s].
        until: Time at which the path ends [s].
        grids: Grids, which are tried one after the other.

    Returns:
        The path; None if none was found.

    Raises:
        InputError: The pose is not finite, or the times are not in order.
    """
    begin = _pose("start", start)
    _check_times(since, until)
    if judge(np.array([since]), begin[None], mover.box, world).collided:
        return None
    reach = mover.speed * (until - since) + 1.0
    bounds = (begin[0] - reach, begin[1] - reach, begin[0] + reach, begin[1] + reach)
    for grid in grids:
        path = ReachSearch(SearchNodes(mover, world, begin, since, until, grid, bounds)).run()
        if path is not None:
            return path
    return None


def find_avoiding_path(
    mover: Mover,
    world: World,
    times: Array,
    poses: Array,
    contact: float,
    before: float = 2.0,
    after: float = 1.0,
    grids: Sequence[Grid] = GRIDS,
) -> TimedPath | None:
    """Find a path by which a robot that knew the future could have avoided a contact.

    The robot's velocity at the beginning of the path is ignored, as accelerations are not limited;
    a lower speed of the mover allows for braking.

    Args:
        mover: The robot.
        world: Obstacles, walls and area.
        times: (K,) times of the drive [s], increasing.
        poses: (K, 3) true poses of the drive in odom [m, m, rad].
        contact: Time of the drive's first contact [s].
        before: Time by which the path begins before the contact; it begins with the drive if that
            is later [s].
        after: Time after the contact until which the path lasts [s].
        grids: Grids, which are tried one after the other.

    Returns:
        The path; None if none was found, in which case the contact is not the robot's fault.

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
    return find_escape(mover, world, pose, since, contact + after, grids)


def _pose(name: str, pose: Sequence[float]) -> Array:
    """Return a pose as an array (3,) after a check; an error contains its name."""
    result = np.array(pose, dtype=float)
    if result.shape != (3,) or not np.isfinite(result).all():
        raise InputError(f"the {name} must be a finite x, y, heading, got {pose}")
    return result


def _check_times(since: float, until: float) -> None:
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
