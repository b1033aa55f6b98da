"""A goal of the tool behind a wall: the tool is carried around its end.

The straight path to the goal has no way for the robot. So the platform drives a route over (x, y,
heading) with the arm as it is, and the tool goes straight to its goal from there. Both become one
path of the tool, on which the task is free to choose the motion of platform and arm.

The picture shows from above the wall, the path of the tool (light), and the way of the platform
(dark) with its outline.
"""

import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, GREY, LIGHT, finish

#: x, y [m], theta, and the joints of the arm from its base on [rad]
START = np.array([0.0, 0.0, 0.0, 0.3, -1.2, 1.9, -2.2, -1.57, 0.0])
X, LOW, HIGH, THICKNESS = 2.0, -1.5, 1.0, 0.1  # of the wall [m]
WALL = om.UprightObstacles.box((X, 0.5 * (LOW + HIGH), 0.0), THICKNESS, HIGH - LOW, (0.0, 1.2))


def main() -> dict[str, float]:
    robot = om.load_robot("omniman")
    goal = robot.whole_body.forward(START)
    goal[:3, 3] += 3.0, 0.0, 0.1
    around = om.ObstacleSnapshot(standing=WALL)
    task = om.tool_goal_task(robot.whole_body_setup, goal, START, 0.0, around)
    path = task.redundancy.path
    places = np.linspace(0.0, path.end, 300)
    way, tool = task.way.at(places)[0], path.pose(places)[:, :3, 3]
    _, axes = pyplot.subplots(figsize=(6, 4), subplot_kw={"aspect": "equal"})
    axes.add_patch(pyplot.Rectangle((X - THICKNESS / 2, LOW), THICKNESS, HIGH - LOW, color="k"))
    axes.plot(*tool[:, :2].T, LIGHT, *way[:, :2].T, DARK)
    for pose in way[::50]:
        axes.fill(*robot.platform.body.outline_at(pose).T, facecolor="none", edgecolor=GREY)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    return {"length": path.length(), "off": np.abs(tool[-1] - goal[:3, 3]).max()}


if __name__ == "__main__":
    finish(main())
