r"""What a Mecanum base can really do.

Planners bound each component of a twist by itself, by a box, or all of them by an ellipsoid. The
wheels bound it otherwise: no $\dot\varphi_i$ may exceed $\dot\varphi_{max}$, so that
$|J \dot x_R| \le \dot\varphi_{max}$ holds in each row (CCTA 2017, (9)). That is a polytope; for
four equal Mecanum wheels at $(\pm a, \pm b)$ it is the octahedron
$|\dot x| + |\dot y| + (a + b)\,|\dot\theta| \le r\,\dot\varphi_{max}$.

The picture shows what the wheels reach without rotation and at half of the largest yaw rate,
beside box and ellipse of the maxima, and the whole polytope in the box, of which it is a sixth.
"""

import numpy as np
from matplotlib import pyplot
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import omniman_ros as om
from picture import DARK, GREY, INK, LIGHT, finish

LABELS = {"box ": 0.9, "ellipse": 0.6, "half the\nyaw rate": 0.0, "no yaw": -0.38}


def main() -> dict[str, float]:
    twists = om.load_robot("omniman").reachable_twists
    largest = twists.maxima  # [m/s, m/s, rad/s]
    box, ellipsoid = 8 * largest.prod(), 4 / 3 * np.pi * largest.prod()

    figure = pyplot.figure(figsize=(8, 3.8))
    axes = figure.add_subplot(1, 2, 1, aspect="equal", xlabel="forward [m/s]", ylabel="left [m/s]")
    x, y, yaw_rate = largest
    angle = np.linspace(0, 2 * np.pi, 200)
    axes.plot([-x, x, x, -x, -x], [-y, -y, y, y, -y], color=GREY)
    axes.plot(x * np.cos(angle), y * np.sin(angle), color=LIGHT)
    axes.fill(*twists.section(0.0).T, facecolor=DARK, alpha=0.35)
    axes.fill(*twists.section(0.5 * yaw_rate).T, facecolor="none", edgecolor=DARK, linestyle="--")
    for text, at in LABELS.items():
        axes.annotate(text, (at * x, at * y), ha="center", va="center", color=INK)
    axes = figure.add_subplot(1, 2, 2, projection="3d")
    axes.add_collection3d(Poly3DCollection(twists.faces, color=DARK, alpha=0.35, edgecolor=DARK))
    axes.set(xlim=(-x, x), ylim=(-y, y), zlim=(-yaw_rate, yaw_rate), xticks=[-1, 0, 1])
    axes.set(xlabel="forward [m/s]", ylabel="left [m/s]", zlabel="yaw rate [rad/s]")
    axes.set_box_aspect(None, zoom=0.85)
    return {"of_the_box": twists.volume / box, "of_the_ellipsoid": twists.volume / ellipsoid}


if __name__ == "__main__":
    finish(main())
