r"""The whole body around a post, while the tool stays on its line.

Along a line of the tool, the pose of the platform is free. The task searches a way for it, and a
receding-horizon control moves the platform in the coordinates $z = (x, y, \theta, s)$, one
Gauss-Newton step every 50 ms, so that platform and arm keep their gaps $d_i(z) \ge d_{min}$ to
the post and to each other. The arm follows by its inverse kinematics in closed form: the tool
never leaves its line. Each plan is checked to its end before it is followed.

The picture shows from above the line of the tool, the post (light), and the way of the platform
around it (dark), beside the way that it would take without the post (dashed).
"""

import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, GREY, LIGHT, finish

#: x, y [m], theta, and the joints of the arm from its base on [rad]
START = np.array([0.0, 0.0, 0.0, 0.3, -1.2, 1.9, -2.2, -1.57, 0.0])
X, Y, RADIUS = 1.3, -0.25, 0.1  # of the post [m]
POST = om.ObstacleSnapshot(standing=om.UprightObstacles.cylinder(X, Y, RADIUS, (0.0, 1.2)))


def main() -> dict[str, float]:
    robot = om.load_robot("omniman")
    line = np.repeat(robot.whole_body.forward(START)[None], 10, axis=0)  # poses of the tool
    line[:, 0, 3] += np.linspace(0.18, 1.8, 10)
    task = om.WholeBodyTask(robot.whole_body_setup, line, START, 0.0, POST)
    now, gaps, rows = 0.0, [], []
    while not task.is_completed(now):
        gaps.append(task.cycle(now, POST).verdict.gap)
        rows.append(task.axes(np.array([now]))[0])
        now += 0.05
    way, tool = np.array(rows), robot.whole_body.forward(np.array(rows))[:, :3, 3]
    planner = om.ToolPlanner(robot.whole_body, robot.whole_body_limits, robot.tool_paths)
    without = planner.plan(line, START).curve.positions
    _, axes = pyplot.subplots(figsize=(7, 3.6), subplot_kw={"aspect": "equal"})
    axes.plot(*tool[:, :2].T, LIGHT, *way[:, :2].T, DARK, *without[:, :2].T, "k--")
    axes.add_patch(pyplot.Circle((X, Y), RADIUS, color=LIGHT))
    for pose in way[:: len(way) // 4, :3]:
        axes.fill(*robot.platform.body.outline_at(pose).T, facecolor="none", edgecolor=GREY)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    return {"arrival": now, "gap": min(gaps), "off": np.abs(tool[:, 1:] - tool[0, 1:]).max()}


if __name__ == "__main__":
    finish(main())
