"""Approach of a station: how fast, and around the leader instead of through it."""

import math

Vector = tuple[float, float]  #: A vector in the plane [m] or [m/s]


def approach_speed(distance: float, gain: float, deceleration: float) -> float:
    """Return the speed with which to close a distance, of the distance's sign.

    It is proportional to small distances, and the square root that a constant deceleration gives
    for larger ones; both have the same slope where they meet.

    Args:
        distance: Distance [m or rad].
        gain: Slope for small distances [1/s].
        deceleration: Deceleration for larger ones [m/s^2 or rad/s^2].
    """
    proportional = deceleration / gain**2
    if abs(distance) <= proportional:
        return gain * distance
    speed = math.sqrt(2.0 * deceleration * (abs(distance) - 0.5 * proportional))
    return math.copysign(speed, distance)


def way_around(start: Vector, goal: Vector, radius: float) -> tuple[float, Vector]:
    """Return the shortest way to a goal around a disc at the origin.

    Args:
        start: Place at which the way starts [m]; inside the disc, it starts as a tangent there.
        goal: Place at which it ends [m], outside of the disc or on its edge.

    Returns:
        Length of the way [m], and its direction at the start: a unit vector, zero at the goal.
    """
    dx, dy = goal[0] - start[0], goal[1] - start[1]
    length = math.hypot(dx, dy)
    if length == 0.0:
        return 0.0, (0.0, 0.0)
    nearest = -(start[0] * dx + start[1] * dy) / length
    miss = abs(start[0] * dy - start[1] * dx) / length
    if miss >= radius or not 0.0 < nearest < length:
        return length, (dx / length, dy / length)
    from_start, from_goal = max(math.hypot(*start), radius), max(math.hypot(*goal), radius)
    cross = start[0] * goal[1] - start[1] * goal[0]
    dot = start[0] * goal[0] + start[1] * goal[1]
    arc = math.atan2(abs(cross), dot)
    arc -= math.acos(radius / from_start) + math.acos(radius / from_goal)
    straight = math.sqrt(from_start**2 - radius**2) + math.sqrt(from_goal**2 - radius**2)
    tangent = math.copysign(math.asin(radius / from_start), -cross)
    heading = math.atan2(-start[1], -start[0]) + tangent
    return straight + radius * max(arc, 0.0), (math.cos(heading), math.sin(heading))
