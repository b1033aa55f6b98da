"""Values formatted for people."""

import math

from omniman_ros.core.planar import Triple


def pose_text(pose: Triple) -> str:
    """Return a pose (x, y, heading) [m, m, rad] as text, without minus signs on zeros."""
    x, y = (round(value, 2) + 0.0 for value in pose[:2])
    degrees = round(math.degrees(math.remainder(pose[2], math.tau)))
    return f"x {x:+.2f} m  y {y:+.2f} m  heading {degrees:+4d} deg"
