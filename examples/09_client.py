"""The client of a running robot: tool, path and goal.

`om.Robot` is a robot that runs, as an object: of `omniman up`, of launch files, or real hardware.
Here `om.simulated_robot` starts one and ends it. A motion returns a handle at once; `wait` returns
when the motion has arrived, and raises an error with the node's reason if it has not. At the end
of the `with` block, at an error or at Ctrl-C the robot stops.

The picture shows the way of the platform (dark) with the tool (light), which moves ahead and up,
then along a path, and to a goal past a post.
"""

import time

import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, GREY, LIGHT, finish

POST = (1.5, 0.6, 0.2)  # x, y, radius [m]
PATH, GOAL = [(0.5, 0.0, 0.0), (0.5, 0.5, 0.0)], (2.5, 0.5, 0.0)  # x, y [m], heading [rad]
TOOL = (0.4, 0.0, 0.2)  # forward, left and up [m]


def watched(robot: om.Robot, motion: om.MotionHandle) -> list[list[float]]:
    way = []
    while motion.outcome is None:
        way.append([*robot.pose.value[:2], *robot.tool.value[:2]])
        time.sleep(0.1)
    motion.wait()  # it has ended: an error unless it has arrived
    return way


def main() -> dict[str, float]:
    with om.simulated_robot("omniman") as robot:
        robot.add_obstacle("post", *POST)
        way = watched(robot, robot.move_tool(*TOOL, relative=True))
        way += watched(robot, robot.follow(PATH))
        way += watched(robot, robot.go_to(*GOAL))
    x, y, tool_x, tool_y = np.array(way).T
    _, axes = pyplot.subplots(figsize=(6, 4.2))
    axes.plot(x, y, DARK, tool_x, tool_y, LIGHT)
    axes.add_patch(pyplot.Circle(POST[:2], POST[2], color=GREY))
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    return {"gap": np.hypot(x - POST[0], y - POST[1]).min() - POST[2], "end_x": x[-1]}


if __name__ == "__main__":
    finish(main())
