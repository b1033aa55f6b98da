"""Two robots meet in motion, drive beside each other as for handing over a load, and part again.

MPC 2021, 5, names this as a use of goals that move. A drive is judged by the true poses of both.
"""

from dataclasses import dataclass

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.lab.studies.mpc_loop import MotionRecord
from omniman_ros.lab.studies.scene_gaps import wall_gap
from omniman_ros.lab.studies.scene_geometry import Box
from omniman_ros.lab.studies.tool_path import DEMO_MISMATCH, WHEELS, Wheels

SPEED = 0.3  # speed of the leader along its path [m/s]
SIDE_GAP = 0.6  # gap between the sides of the two robots at the station [m]
KEPT_TIME = 5.0  # time for which the station is to be kept [s]
UNCALIBRATED = "radii"  # name of the wheels with radii that neither robot knows
HANDOVER_WHEELS = {
    "PI": WHEELS["PI"],
    "P": WHEELS["P"],
    UNCALIBRATED: Wheels(
        "wheels of the demo, radii off by up to 0.2 %",
        {},
        {**DEMO_MISMATCH, "radius": [1.002, 0.998, 1.001, 0.999]},
    ),
}
"""Wheels of the leader, by name; the follower has them in reverse order."""


@dataclass(frozen=True)
class Case:
    """One drive of the study."""

    follower: str  # node that leads the follower: `station_keeper` or `mpc_planner`
    course: str  # shape of the leader's path, a key of `tool_courses.COURSES`
    wheels: str  # wheels of the robots, a key of `HANDOVER_WHEELS`
    seed: int = 0  # seed of the latencies

    @property
    def is_aim(self) -> bool:
        """Whether the station is to be kept.

        The planner is driven for comparison, and no odometry knows of radii that are off.
        """
        return self.follower == "station_keeper" and self.wheels != UNCALIBRATED


@dataclass(frozen=True)
class Run:
    """A completed drive, with a row for each of K ticks of 5 ms."""

    case: Case  # the case
    offset: Triple  # pose of the station in base_link of the leader [m, m, rad]
    box: Box  # outline of each robot
    times: Array  # (K,) times since the follower was sent to the station [s]
    leader: Array  # (K, 3) true poses of the leader [m, m, rad]
    follower: Array  # (K, 3) true poses of the follower [m, m, rad]
    energies: Array  # (K, 2) electric energy that leader and follower have consumed [J]
    kept_from: float  # time at which the judged time begins [s]

    @staticmethod
    def of(
        case: Case,
        offset: Triple,
        box: Box,
        leader: MotionRecord,
        follower: MotionRecord,
        kept_from: float,
    ) -> "Run":
        """Return the run that two records contain; both end with the shorter one."""
        first = round((follower.times[0] - leader.times[0]) / PERIOD)
        count = min(len(leader.times) - first, len(follower.times))
        rows = slice(first, first + count)
        energies = np.column_stack([leader.energy[rows], follower.energy[:count]])
        return Run(
            case,
            offset,
            box,
            np.array(follower.times[:count]) - follower.times[0],
            np.array(leader.poses[rows]),
            np.array(follower.poses[:count]),
            energies - energies[0],
            kept_from - follower.times[0],
        )

    @property
    def kept(self) -> slice:
        """Rows of the judged time."""
        first = round(self.kept_from / PERIOD)
        return slice(first, first + round(KEPT_TIME / PERIOD) + 1)

    def errors(self) -> Array:
        """Return the true poses (K, 3) of the follower in the frame of the station [m, m, rad].

        The station is that beside the true leader.
        """
        pairs = zip(self.leader.tolist(), self.follower.tolist(), strict=True)
        return np.array([station_error(leader, self.offset, own) for leader, own in pairs])

    def gaps(self) -> Array:
        """Return the true gaps (K,) between the outlines of the robots [m]."""
        size = np.tile([self.box.length, self.box.width], (len(self.leader), 1))
        return wall_gap(self.follower, self.box, np.hstack([self.leader, size]))

    def speeds(self) -> Array:
        """Return the true speeds (K, 2) of leader and follower [m/s]."""
        rates = [
            np.gradient(poses[:, :2], PERIOD, axis=0) for poses in (self.leader, self.follower)
        ]
        return np.column_stack([np.hypot(rate[:, 0], rate[:, 1]) for rate in rates])


def station_error(leader: Triple, offset: Triple, follower: Triple) -> Triple:
    """Return the pose of a follower in the frame of its station [m, m, rad]."""
    station = se2.compose(leader, offset)
    difference = np.array([follower[0] - station[0], follower[1] - station[1], 0.0])
    x, y, _ = se2.to_robot(station[2], difference).tolist()
    return x, y, se2.wrap(follower[2] - station[2])
