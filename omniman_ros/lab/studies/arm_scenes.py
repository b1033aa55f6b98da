"""Random scenes for a robot whose arm is in a random posture, among obstacles of all heights.

They are those of `scene_generator`; each obstacle gets heights, and the arm a posture. A drive is
judged by the physics engine in three dimensions, at its samples and between them.
"""

import math
from dataclasses import replace

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.lab.studies.scene_generator import (
    MARGIN,
    RandomScene,
    SceneError,
    scene,
)
from omniman_ros.lab.studies.scene_geometry import Area, Box
from omniman_ros.lab.studies.scene_judge import Verdict, first_contact, relative_travel
from omniman_ros.lab.studies.scenes import Outcome, SceneDrive
from omniman_ros.simulation.world.distances import PostureDistances, Prism

ABOVE = 2.2  # height above the highest point of the arm [m]
KINDS = (
    (0.4, (0.0, 0.0), (ABOVE, ABOVE)),
    (0.6, (0.0, 0.0), (0.1, 0.45)),
    (0.8, (0.0, 0.0), (0.6, 1.2)),
    (0.9, (0.65, 0.75), (0.76, 0.8)),
    (1.0, (0.7, 1.5), (ABOVE, ABOVE)),
)
"""Kinds of obstacles: posts, pallets, cupboards, table tops and hanging things. Each has the
cumulated probability, and the ranges of the lower and the upper side [m]."""
LEAST_CLEARANCE = 0.02  # distance that the arm keeps from platform and floor in a posture [m]
MAX_DRAWS = 400  # largest number of draws of posture and heights for a scene
REACH = 1.0  # distance up to which distances are computed [m]
MAX_SKIP = 20  # largest number of samples of a drive that are skipped: 0.1 s
GAP_ACCURACY = 0.005  # accuracy of the least gap of a drive [m]


class ArmBody:
    """The robot with its arm in the posture of a scene, among the scene's obstacles.

    Attributes:
        speeds: (M,) largest speeds of the obstacles [m/s].
    """

    def __init__(self, description: DescriptionParameters, random_scene: RandomScene) -> None:
        self._posture = np.array(random_scene.posture)
        self._obstacles = random_scene.obstacles
        self.speeds = np.array([obstacle.place.speed for obstacle in self._obstacles])
        prisms = [
            Prism(obstacle.semi_axes, obstacle.angle, heights)
            for obstacle, heights in zip(self._obstacles, random_scene.heights, strict=True)
        ]
        self._shapes = PostureDistances(description, prisms)
        self.place(0.0, np.zeros(3))
        corners = self._shapes.outline()
        self.radius = float(np.hypot(corners[:, 0], corners[:, 1]).max())
        self.clearance = self._shapes.arm_clearance()

    def place(self, time: float, pose: Array) -> None:
        """Place the robot at a pose (3,) and the obstacles where they are at a time [s]."""
        places = np.array([obstacle.place(time) for obstacle in self._obstacles]).reshape(-1, 2)
        self._shapes.place(pose, self._posture, places)

    def gaps(self) -> Array:
        """Return the distances (M,) of the obstacles from the robot, at most REACH [m]."""
        return self._shapes.distances(REACH)

    def outside(self, area: Area | None) -> float:
        """Return the distance by which the robot leaves an area [m]; -inf without one."""
        if area is None:
            return -math.inf
        points = self._shapes.outline()[:, :2]
        return float(np.maximum(np.array(area[:2]) - points, points - np.array(area[2:])).max())


def arm_scene(seed: int, box: Box, description: DescriptionParameters) -> RandomScene:
    """Return the scene of a seed, with a posture and heights that leave room at start and goal."""
    base, random = scene(seed, box), np.random.default_rng((20260, seed))
    for _ in range(MAX_DRAWS):
        made = replace(
            base,
            posture=tuple(random.uniform(-math.pi, math.pi, 6).tolist()),
            heights=tuple(_draw_heights(random) for _ in base.obstacles),
        )
        if _has_room(ArmBody(description, made), made):
            return made
    raise SceneError(f"no posture with enough room was found for seed {seed}")


def _draw_heights(random: np.random.Generator) -> tuple[float, float]:
    """Draw the heights of the lower and the upper side of an obstacle [m]."""
    draw = random.random()
    _, low, high = next(kind for kind in KINDS if draw <= kind[0])
    return float(random.uniform(*low)), float(random.uniform(*high))


def _has_room(body: ArmBody, made: RandomScene) -> bool:
    """Return whether the arm is above the floor, and the robot has room at start and goal."""
    if body.clearance < LEAST_CLEARANCE:
        return False
    for pose, fixed_only in ((made.start, False), (made.goal, True)):
        body.place(0.0, np.array(pose))
        counts = [obstacle.fixed or not fixed_only for obstacle in made.obstacles]
        gaps = body.gaps()[np.array(counts, dtype=bool)]
        if gaps.min(initial=math.inf) < MARGIN or body.outside(made.workspace) > -MARGIN:
            return False
    return True


def judge_arm_drive(
    made: RandomScene, drive: SceneDrive, description: DescriptionParameters
) -> Outcome:
    """Judge a drive in three dimensions."""
    return Outcome(made, drive, judge(drive.times, drive.poses, made, ArmBody(description, made)))


def judge(times: Array, poses: Array, made: RandomScene, body: ArmBody) -> Verdict:
    """Judge a drive, given by its samples (K,) [s] and (K, 3) [m, m, rad], like `scene_judge`.

    Samples at which no gap can be less than the least one so far, less GAP_ACCURACY, are skipped.
    """
    poses = np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
    travel = relative_travel(times, poses, body.radius, body.speeds)
    least, outside, k = math.inf, -math.inf, 0
    rows: list[int] = []
    seen: list[Array] = []
    while k < len(times):
        body.place(float(times[k]), poses[k])
        gaps = body.gaps()
        rows, seen = [*rows, k], [*seen, gaps]
        outside = max(outside, body.outside(made.workspace))
        least = min(least, float(gaps.min(initial=math.inf)))
        ahead = travel[k + 1 : k + 1 + MAX_SKIP] - travel[k]
        safe = (ahead < gaps - max(least - GAP_ACCURACY, 0.0)).all(axis=1)
        k += max(int(safe.sum() if safe.all() else safe.argmin()), 1)
    contact, touched = first_contact(times[rows], np.array(seen), travel[rows])
    return Verdict(least if touched is None else min(least, 0.0), contact, touched, outside)
