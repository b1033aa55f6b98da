r"""Model predictive control among moving obstacles.

Every 50 ms the planner minimises the energy of the motors, $\int u^\top i \, dt$, with costs for
the distance from the goal, over the next two seconds, subject to the dynamics of platform and
motors and to the clearance from obstacles as they are predicted to move (MPC 2021, (25) to (31)).
It returns a motion that ends at rest and was checked to its end.

The picture shows the platform, its way and its plan (dashed), and two people who give way to none.
"""

import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, LIGHT, finish

PERIOD, RADIUS = 0.05, 0.3  # of the planner [s], of a person [m]
PLACES, VELOCITIES = np.array([[1.4, -1.6], [2.8, 2.2]]), np.array([[0.0, 0.5], [-0.1, -0.5]])
PEOPLE = om.Ellipses.circles(0.0, PLACES, VELOCITIES, RADIUS)


def main() -> dict[str, float]:
    robot = om.load_robot("omniman")
    planner, plans = om.Planner(robot.planner), []
    states = [om.MeasuredState(0.0, np.zeros(3), np.zeros(3))]
    planner.drive(om.PoseGoal(np.array([4.0, 0.0, 0.0])), states[0], PEOPLE)
    while planner.active:
        now = states[-1].time
        plans.append(planner.cycle(now, states[-1], PEOPLE))
        states.append(om.MeasuredState.on(plans[-1], now + PERIOD))  # it is followed exactly

    way, gaps = np.array([state.pose for state in states]), []
    for state in states:
        c, s = np.cos(state.pose[2]), np.sin(state.pose[2])
        seen = (PLACES + state.time * VELOCITIES - state.pose[:2]) @ [[c, -s], [s, c]]
        gaps.append(planner.footprint.whole.distances(seen).min() - RADIUS)
    _, panels = pyplot.subplots(2, 2, sharex=True, sharey=True, figsize=(7, 5))
    for axes, k in zip(panels.flat, np.linspace(0, 0.75 * len(plans), 4).astype(int), strict=True):
        axes.fill(*robot.platform.body.outline_at(way[k]).T, color=DARK, alpha=0.3)
        axes.plot(*way[: k + 1, :2].T, color=DARK)
        axes.plot(*plans[k].poses[:, :2].T, "--", color=DARK)
        for place, velocity in zip(PLACES + states[k].time * VELOCITIES, VELOCITIES, strict=True):
            axes.add_patch(pyplot.Circle(place, RADIUS, color=LIGHT))
            axes.arrow(*place, *velocity, width=0.03, color=LIGHT)
        axes.set(title=f"{states[k].time:.1f} s", aspect="equal", xlabel="x [m]", ylabel="y [m]")
    return {"arrival": states[-1].time, "gap": min(gaps)}


if __name__ == "__main__":
    finish(main())
