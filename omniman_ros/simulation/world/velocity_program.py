"""The velocity next to a wanted one that half-planes permit.

Source: J. van den Berg, S. J. Guy, M. Lin and D. Manocha, "Reciprocal n-Body Collision Avoidance",
Robotics Research, STAR 70 (2011): a linear program in two dimensions, solved incrementally, and
one in three where no velocity is permitted. Two dozen half-planes of two numbers each are faster
to go through one by one than as arrays.
"""

import math
from collections.abc import Sequence

HalfPlane = tuple[float, float, float]  #: Unit normal (x, y) and the least velocity along it [m/s]
Velocity = tuple[float, float]  #: Velocity (x, y) [m/s]
TOLERANCE = 1e-9  #: By how much a half-plane may be violated [m/s]
FAR = 1e6  #: Where an objective lies that is a direction, over the largest speed


def nearest_velocity(
    wanted: Velocity, limit: float, hard: Sequence[HalfPlane], soft: Sequence[HalfPlane]
) -> Velocity:
    """Return the velocity next to `wanted` that all half-planes permit.

    If there is none, it is the one that violates the worst of the soft half-planes least. If the
    hard ones alone permit none, all are soft.

    Args:
        wanted: Wanted velocity (x, y) [m/s].
        limit: Largest speed [m/s].
        hard: Half-planes that are kept at any rate.
        soft: Half-planes that may be violated if it has to be.
    """
    planes = [*hard, *soft]
    found, failed = _program(planes, limit, wanted)
    if failed == len(planes):
        return found
    first = len(hard)
    if failed < first:
        first, failed = 0, 0
    # As in the paper's third program: of the half-planes so far, the worst is made as good as
    # it can be without another one becoming worse.
    worst = 0.0
    for i in range(failed, len(planes)):
        nx, ny, least = planes[i]
        if least - nx * found[0] - ny * found[1] <= worst + TOLERANCE:
            continue
        bounds = list(planes[:first])
        for mx, my, other in planes[first:i]:
            dx, dy = mx - nx, my - ny
            size = math.hypot(dx, dy)
            if size > TOLERANCE:
                bounds.append((dx / size, dy / size, (other - least) / size))
        better, reached = _program(bounds, limit, (FAR * limit * nx, FAR * limit * ny))
        if reached == len(bounds):
            found = better
        worst = max(worst, least - nx * found[0] - ny * found[1])
    return found


def _program(planes: Sequence[HalfPlane], limit: float, wanted: Velocity) -> tuple[Velocity, int]:
    """Return the permitted velocity next to the wanted one, and the number of planes kept."""
    size = math.hypot(*wanted)
    scale = limit / size if size > limit else 1.0
    x, y = scale * wanted[0], scale * wanted[1]
    for i, (nx, ny, least) in enumerate(planes):
        if nx * x + ny * y >= least - TOLERANCE:
            continue
        at = _on_line(planes[:i], planes[i], limit, wanted)
        if at is None:
            return (x, y), i
        x, y = nx * least - ny * at, ny * least + nx * at
    return (x, y), len(planes)


def _on_line(
    planes: Sequence[HalfPlane], line: HalfPlane, limit: float, wanted: Velocity
) -> float | None:
    """Return where on the border of a half-plane the best velocity lies; None if nowhere."""
    nx, ny, least = line
    if abs(least) > limit:
        return None
    high = math.sqrt(limit * limit - least * least)
    low = -high
    for mx, my, other in planes:
        slope = my * nx - mx * ny
        room = other - least * (mx * nx + my * ny)
        if abs(slope) <= TOLERANCE:
            if room > TOLERANCE:
                return None
        elif slope > 0.0:
            low = max(low, room / slope)
        else:
            high = min(high, room / slope)
    if low > high:
        return None
    return min(max(wanted[1] * nx - wanted[0] * ny, low), high)
