r"""Coupling control, on and off.

Four wheels have one speed too many for a motion in the plane: their speeds fit together only if
$T \dot\varphi = 0$. What a wheel lags behind adds up to the coupling error
$\epsilon = \int T \dot\varphi\, dt$, and becomes slip. The coupling controller feeds
$-k_\epsilon\,\epsilon$ to the wheels in the one direction that does not move the platform
(CCTA 2017, (24) and (25), and the experiment of Fig. 7). Here one drive is 2 % slow.

The picture shows the coupling error over five movements, without control (light) and with it.
"""

import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, GREY, LIGHT, finish

#: Forwards, sideways, backwards, and twice around a circle [m/s, m/s, rad/s], for 1.5 s each
MOVEMENTS = ([0.4, 0, 0], [0, 0.4, 0], [-0.4, 0, 0], [0.4, 0, 0.5], [0.4, 0, 0.5])
TICK, SECONDS = 0.005, 1.5


def drive(k_epsilon: float) -> np.ndarray:
    robot = om.load_robot("omniman").changed({"coupling.k_epsilon": k_epsilon})
    controller = om.PlatformController(robot.controller)
    drives = om.SimulatedDrives(robot.platform, robot.simulation)
    errors = []
    for k in range(round(len(MOVEMENTS) * SECONDS / TICK)):
        now = k * TICK
        wheels = drives.wheel_states(now)
        controller.update_wheels(now, now, wheels.position, wheels.velocity)
        controller.set_twist(np.array(MOVEMENTS[int(now / SECONDS)]), now)
        command = controller.tick(now)
        drives.command_velocity(command.velocity * [1, 1, 1, 0.98], command.effort, now)
        errors.append(controller.odometry.coupling_error[0])
    return np.array(errors)


def main() -> dict[str, float]:
    off, on = drive(0.0), drive(15.0)
    time = TICK * np.arange(len(off))
    axes = pyplot.figure(figsize=(6, 3)).add_subplot()
    axes.vlines(SECONDS * np.arange(1, len(MOVEMENTS)), -60, 100, color=GREY, linewidth=0.5)
    axes.plot(time, 1e3 * off, LIGHT, time, 1e3 * on, DARK)
    axes.set(xlabel="time [s]", ylabel="coupling error [mrad]")
    return {"largest_off": np.abs(off).max(), "largest_on": np.abs(on).max()}


if __name__ == "__main__":
    finish(main())
