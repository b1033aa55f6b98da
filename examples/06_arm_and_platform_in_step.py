r"""Arm and platform in step, on one path of nine axes.

A path $q(u)$ of all axes, $x$, $y$, $\theta$ of the platform and the six joints of the arm, gets
one time law $u(t)$: the fastest at which each axis keeps its limits on velocity, acceleration and
jerk, and no wheel exceeds its speed. The platform's limits hold for the vector $(\dot x, \dot y)$.
Platform and arm start and arrive together; CCTA 2017, V.A sends them on one time base.

The picture shows the motion from above, with a dot each half second, and how much of its limit on
velocity each axis uses: platform dark, arm light.
"""

import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, GREY, LIGHT, finish

#: x, y [m], theta, and the joints of the arm from its base on [rad]
START = np.array([0.0, 0.0, 0.0, 0.3, -1.2, 1.9, -2.2, -1.57, 0.0])
VIA = np.array([0.8, 0.2, 0.5, 2.5, -1.5, 2.2, -2.2, -1.57, 0.5])
END = np.array([1.2, 1.2, 1.57, -0.5, -0.9, 1.2, -1.9, -1.57, 0.0])
#: Cut the corner at VIA, and drive as fast as the robot can
OPTIONS = {"joint_trajectory.corner_tolerance": 0.1, "path.linear_velocity": 1.0}


def main() -> dict[str, float]:
    robot = om.load_robot("omniman").changed(OPTIONS)
    planner = om.JointPlanner(robot.whole_body_limits, robot.joint_paths)
    curve = planner.through(np.array([VIA, END]), START)
    times = np.arange(0.0, curve.duration, 0.01)
    axes, velocities, _ = curve.sample(times)
    tool = robot.whole_body.forward(axes)[:, :3, 3]
    usage = np.abs(velocities) / robot.whole_body_limits.velocity

    _, (above, below) = pyplot.subplots(1, 2, figsize=(8, 3.6))
    for way, colour in ((axes, DARK), (tool, LIGHT)):
        above.plot(way[:, 0], way[:, 1], color=colour)
        above.plot(way[::50, 0], way[::50, 1], ".", color=colour)
    for pose in axes[[0, -1], :3]:
        above.fill(*robot.platform.body.outline_at(pose).T, color=GREY, alpha=0.3)
    above.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    below.plot(times, usage[:, 3:], color=LIGHT)
    below.plot(times, usage[:, :3], color=DARK)
    below.set(xlabel="time [s]", ylabel="fraction of the limit on velocity")
    return {"duration": curve.duration, "largest_usage": usage.max()}


if __name__ == "__main__":
    finish(main())
