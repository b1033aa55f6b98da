r"""Odometry of a recording of your own.

`10_odometry_of_a_bag.py FOLDER` adds up the rotations in `wheel_states` of a rosbag2 recording, as
arcs on SE(2), $\Delta x_R = J^+ \Delta\varphi$ (CCTA 2017, (13)). Without a folder it records a
simulated robot with a wheel worn by 3 %. Light: by the wheels; dark: ground truth, or else `odom`.
"""

import sys
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, LIGHT, finish

ROBOT = om.load_robot("omniman")  # or the file of your robot


def record(folder: str) -> str:
    worn, rows = ROBOT.changed({"mismatch.radius": [0.97, 1.0, 1.0, 1.0]}), []
    drives = om.SimulatedDrives(worn.platform, worn.simulation)
    for now in np.arange(0.02, 20.0, 0.02):
        drives.command_velocity(ROBOT.kinematics.J @ [0.4, 0, 0.63 * np.sign(10 - now)], None, now)
        wheels, truth = drives.wheel_states(now), np.ravel(drives.ground_truth())
        rows.append(([now, *truth], [now, *wheels.position], [now, *wheels.velocity]))
    truth, angles, speeds = map(np.array, zip(*rows, strict=True))
    log = om.RobotLog(truth=truth, angles=angles, measured=speeds, wheel_names=ROBOT.wheels.names)
    return om.write_recording(folder, log)


def main() -> dict[str, float]:
    with TemporaryDirectory() as temporary:
        given = " ".join(word for word in sys.argv[1:2] if not word.startswith("-"))
        log = om.read_recording(given or record(f"{temporary}/bag"), ROBOT.wheels.names)
    odometry, poses = om.Odometry(ROBOT.kinematics, ROBOT.controller.odometry), []
    truth = log.truth if len(log.truth) else log.odom
    odometry.reset(truth[0, 1:4])
    for step, speeds in zip(np.diff(log.angles, axis=0), log.measured[1:], strict=True):
        odometry.update(step[1:], speeds[1:], dt=step[0])
        poses.append(odometry.pose)
    x, y, _ = np.transpose(poses)
    true_x, true_y = (np.interp(log.angles[1:, 0], truth[:, 0], truth[:, k]) for k in (1, 2))
    axes = pyplot.figure(figsize=(3, 4)).add_subplot(aspect=1, xlabel="x [m]", ylabel="y [m]")
    axes.plot(true_x, true_y, DARK, x, y, LIGHT)
    return {"parted": np.hypot(x - true_x, y - true_y).max()}


if __name__ == "__main__":
    finish(main())
