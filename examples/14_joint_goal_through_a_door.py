"""A goal of platform and joints together: through a door that only one posture fits.

The arm reaches ahead and is to reach aside, behind a door of 1 m. So it moves when the platform
has driven its route, and the task plans both in one redundancy.

The picture shows from above the wall, the way of the tool (light) and of the platform (dark), with
its outline.
"""

import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, GREY, LIGHT, finish

#: x, y [m], theta, and the joints of the arm from its base on [rad]
START = np.array([0.0, 0.0, 0.0, 0.0, -1.2, 1.2, -1.6, -1.57, 0.0])
GOAL = np.array([4.0, 0.0, 0.0, 1.57, -0.8, 0.8, -1.6, -1.57, 0.0])
X, WIDE = 2.0, 0.1  # of the wall [m]
PARTS = [(-2.5, 0.3), (1.3, 2.5)]  # from where to where in y it stands [m]
BOXES = [((X, 0.5 * (low + high), 0.0), WIDE, high - low, (0.0, 1.2)) for low, high in PARTS]
WALL = om.UprightObstacles.join([om.UprightObstacles.box(*box) for box in BOXES])


def main() -> dict[str, float]:
    robot = om.load_robot("omniman")
    around = om.ObstacleSnapshot(standing=WALL)
    task = om.JointGoalTask(robot.whole_body_setup, GOAL, START, 0.0, around)
    places = np.linspace(0.0, task.redundancy.path.end, 300)
    way = np.column_stack([task.way.at(places)[0], places])
    axes = task.redundancy.axes(way)
    tool = robot.whole_body.forward(axes)[:, :3, 3]
    _, picture = pyplot.subplots(figsize=(6, 4), subplot_kw={"aspect": "equal"})
    for low, high in PARTS:
        picture.add_patch(pyplot.Rectangle((X - WIDE / 2, low), WIDE, high - low, color="k"))
    picture.plot(*tool[:, :2].T, LIGHT, *way[:, :2].T, DARK)
    for pose in way[::50, :3]:
        picture.fill(*robot.platform.body.outline_at(pose).T, facecolor="none", edgecolor=GREY)
    picture.set(xlabel="x [m]", ylabel="y [m]")
    beside = np.abs(way[:, 0] - X) < WIDE
    return {
        "off": np.abs(axes[-1] - GOAL).max(),
        "arm_at_the_door": np.abs(axes[beside, 3:] - START[3:]).max(),
    }


if __name__ == "__main__":
    finish(main())
