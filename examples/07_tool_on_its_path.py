r"""The tool on its path, metres long.

The arm reaches 0.85 m. Along a longer path of the tool, $T(s)$ in $SE(3)$, the platform has to
move along, and three of the nine axes are free. `om.ToolPlanner` places the platform where the
arm has room, and finds the arm's joints from $T_{platform}\, T_{arm}(q) = T(s)$ in closed form:
the tool is on its path exactly, whatever the platform does. One time law keeps all limits.

The picture shows a wave that the tool draws on a wall, from the front, and the robot from above:
the tool's way (light) and the platform's, with its outline every four seconds.
"""

import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, GREY, LIGHT, finish

#: x, y [m], theta, and the joints of the arm from its base on [rad]
START = np.array([0.0, 0.0, 0.0, 0.3, -1.2, 1.9, -2.2, -1.57, 0.0])


def main() -> dict[str, float]:
    robot = om.load_robot("omniman")
    planner = om.ToolPlanner(robot.whole_body, robot.whole_body_limits, robot.tool_paths)
    along = np.linspace(0.0, 3.0, 120)[1:]
    poses = np.repeat(robot.whole_body.forward(START)[None], len(along), axis=0)
    poses[:, 0, 3] += along
    poses[:, 2, 3] += 0.15 * np.sin(2.0 * np.pi * along)
    plan = planner.plan(poses, START)

    times = np.arange(0.0, plan.curve.duration, 0.02)
    axes, _, _ = plan.curve.sample(times)
    tool = robot.whole_body.forward(axes)
    errors = np.abs((tool - plan.tool(times))[:, :3, 3])
    _, (front, above) = pyplot.subplots(2, 1, sharex=True, figsize=(7, 3), height_ratios=(1, 2.7))
    front.plot(tool[:, 0, 3], tool[:, 2, 3], color=LIGHT)
    front.set(ylabel="z [m]", aspect="equal")
    above.plot(tool[:, 0, 3], tool[:, 1, 3], color=LIGHT)
    above.plot(axes[:, 0], axes[:, 1], color=DARK)
    for pose in axes[::200, :3]:
        above.fill(*robot.platform.body.outline_at(pose).T, facecolor="none", edgecolor=GREY)
    above.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    return {"length": plan.length, "duration": times[-1], "error": errors.max()}


if __name__ == "__main__":
    finish(main())
