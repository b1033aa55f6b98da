r"""Kinematics of an odd platform.

A platform may have any $n \ge 3$ Mecanum or Omni wheels, of any radius and at any angle. The twist
$\dot x_R$ of the platform gives the wheel speeds, $\dot\varphi = J \dot x_R$, and the
$n - 3$ motion constraints $T \dot\varphi = 0$ say which wheel speeds fit together without slip
(CCTA 2017, (8) to (12)). Here are five wheels, no two alike.

In the picture, the velocity of each contact (grey) is the rolling of the wheel (dark) and that of
the roller, across its axis (light).
"""

import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, GREY, INK, LIGHT, finish

WHEELS = om.Wheels(
    names=("mecanum 1", "mecanum 2", "omni 1", "omni 2", "mecanum 3"),
    x=(0.4, 0.3, -0.1, -0.5, -0.3),  # of the contacts in base_link, forward [m]
    y=(0.3, -0.35, 0.45, 0.1, -0.3),  # left [m]
    heading=(0.0, 0.3, 0.5, 1.5, 0.0),  # rolling directions [rad]
    roller_angle=(-0.785, 0.785, 0.0, 0.0, -0.6),  # of the rollers' axes to the axle [rad]
    radius=(0.127, 0.1, 0.08, 0.08, 0.127),  # [m]
    inertia=(0.05,) * 5,  # [kg m^2]
)
TWIST = np.array([0.4, 0.15, 0.5])  # [m/s, m/s, rad/s]


def main() -> dict[str, float]:
    kinematics = om.PlatformKinematics(WHEELS)
    wheel_speeds = kinematics.J @ TWIST
    constraints = kinematics.T @ wheel_speeds
    error = kinematics.J_pinv @ wheel_speeds - TWIST
    _, axes = pyplot.subplots(figsize=(5.5, 4.6), subplot_kw={"aspect": "equal"})
    axes.set(xlabel="forward [m]", ylabel="left [m]", xlim=(-0.65, 0.65), ylim=(-0.5, 0.6))
    for k, (x, y, d) in enumerate(zip(WHEELS.x, WHEELS.y, WHEELS.heading, strict=True)):
        contact = TWIST[:2] + TWIST[2] * np.array([-y, x])
        direction = np.array([np.cos(d), np.sin(d)])
        rolling = WHEELS.radius[k] * wheel_speeds[k] * direction
        tread = np.array([x, y]) + WHEELS.radius[k] * np.outer([-1, 1], direction)
        axes.plot(*tread.T, color=INK, linewidth=9, alpha=0.3, solid_capstyle="butt")
        for vector, colour in ((contact, GREY), (rolling, DARK), (contact - rolling, LIGHT)):
            axes.quiver(x, y, *vector, color=colour, angles="xy", scale_units="xy", scale=3)
        axes.annotate(WHEELS.names[k], (x, y), (0, -16), textcoords="offset points", ha="center")
    return {"constraint_rate": np.abs(constraints).max(), "error": np.abs(error).max()}


if __name__ == "__main__":
    finish(main())
