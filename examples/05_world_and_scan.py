r"""The platform in a world of physics, with a laser scan.

`om.World` is a scene in the engine MuJoCo: the robot with the rollers of its wheels, walls, posts,
and people who walk. It takes the place of the plant under the same simulated drives and the same
controller. The odometry integrates $J^+ \dot\varphi$ (CCTA 2017, (3)) and does not see slip, so
that it parts from the true pose.

The picture shows the robot and what it scans at the start (grey) and at the end (dark): walls, two
posts, and a person who walks.
"""

import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, GREY, finish

SCENE = om.Scene(
    walls=(om.Wall(name="room", x=(-1, 5, 5, -1, -1), y=(-2, -2, 3, 3, -2)),),
    posts=tuple(om.Post(name=f"post {k}", x=2.0 + k, y=-0.8 + k, radius=0.15) for k in range(2)),
    persons=(om.Person(name="walker", x=(3.6, 3.6), y=(-1.2, 2.4), speed=0.8),),
)
TICK, TWIST = 0.005, np.array([0.6, 0.2, 0.35])  # [s], [m/s, m/s, rad/s]


def main() -> dict[str, float]:
    robot = om.load_robot("omniman")
    world = om.World(robot.description, robot.simulation, robot.world, SCENE)
    drives = om.SimulatedDrives(robot.platform, robot.simulation, body=world)
    scanner, controller = om.Scanner(world, robot.scanner), om.PlatformController(robot.controller)
    _, axes = pyplot.subplots(figsize=(6, 4.6))
    for k in range(600):
        now = k * TICK
        wheels = drives.wheel_states(now)
        controller.update_wheels(now, now, wheels.position, wheels.velocity)
        controller.set_twist(TWIST, now)
        command = controller.tick(now)
        drives.command_velocity(command.velocity, command.effort, now)
        if k in (0, 599):
            colour = DARK if k else GREY
            axes.plot(*scanner.points(scanner.scan()).T, ".", color=colour, markersize=3)
            axes.fill(*robot.platform.body.outline_at(world.pose).T, color=colour, alpha=0.3)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    return {"odometry_error": np.hypot(*(controller.odometry.pose - world.pose)[:2])}


if __name__ == "__main__":
    finish(main())
