"""Pairs of links whose collisions MoveIt need not check, found by sampling."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from itertools import combinations, pairwise

import numpy as np

from omniman_ros.collision.body_geometry import PLATFORM, BodyGeometry
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.description.platform_shape import WHEEL_WIDTH
from omniman_ros.description.ur5 import BASE, links

SAMPLES = 10_000  #: Number of random postures of the arm
SEED = 0  #: Seed of the postures
#: Least distance at all postures from which on a pair is not checked [m].
#:
#: Between the samples, links may come a little nearer.
CLEARANCE = 0.02


class Reason(Enum):
    """Why the collisions of two links are not checked; the values are those of an SRDF.

    ADJACENT: Neighbours, which touch at their joint.
    DEFAULT: Near each other at all joint angles, so that their simple shapes may overlap while the
        links do not.
    NEVER: Always clear of each other.
    """

    ADJACENT = "Adjacent"
    DEFAULT = "Default"
    NEVER = "Never"


@dataclass(frozen=True)
class UncheckedPair:
    """Two links whose collisions are not checked.

    Attributes:
        first, second: Names of the links.
    """

    first: str
    second: str
    reason: Reason  #: Why


def unchecked_pairs(description: DescriptionParameters) -> list[UncheckedPair]:
    """Return the pairs of links whose collisions need not be checked.

    Besides neighbours, these are pairs that keep clear of each other at all of 10,000 random
    postures within the limits of the joints, by the capsules that contain the links of the arm,
    and those whose distance the joints hardly change.
    """
    geometry = BodyGeometry(description)
    wheels = [f"{name}_wheel" for name in description.robot.wheels.names]
    arm = [BASE.name, *(link.name for link in links())]
    least = _least_distances(description, geometry)
    pairs = [UncheckedPair("base_link", wheel, Reason.ADJACENT) for wheel in wheels]
    pairs.append(UncheckedPair("base_link", BASE.name, Reason.ADJACENT))
    pairs += [
        UncheckedPair(first, second, Reason.NEVER) for first, second in combinations(wheels, 2)
    ]
    pairs += [UncheckedPair(first, second, Reason.ADJACENT) for first, second in pairwise(arm)]
    pairs += _clear_pairs(("base_link", *wheels), arm, least)
    return pairs


def _clear_pairs(
    platform: tuple[str, ...], arm: list[str], least: Mapping[tuple[str, str], float]
) -> Iterator[UncheckedPair]:
    """Yield the pairs with a link of the arm that are no neighbours and always clear."""
    candidates = [(first, second) for first in platform for second in arm]
    candidates += [pair for pair in combinations(arm, 2) if pair not in set(pairwise(arm))]
    for pair in candidates:
        if pair == ("base_link", BASE.name):
            continue
        if pair not in least:
            yield UncheckedPair(*pair, Reason.DEFAULT)
        elif least[pair] > CLEARANCE:
            yield UncheckedPair(*pair, Reason.NEVER)


def _least_distances(
    description: DescriptionParameters, geometry: BodyGeometry
) -> dict[tuple[str, str], float]:
    """Return the least distances of pairs of links that may collide [m], by their names."""
    configurations = _configurations(description)
    own = geometry.self_distances(configurations).min(axis=0)
    found = {
        (first.replace(PLATFORM, "base_link"), second): float(distance)
        for (first, second), distance in zip(geometry.pairs, own, strict=True)
    }
    wheels = description.robot.wheels
    boxes = UprightObstacles.join(
        [
            UprightObstacles.box(
                (wheels.x[i], wheels.y[i], wheels.heading[i]),
                2.0 * wheels.radius[i],
                WHEEL_WIDTH * wheels.radius[i],
                (0.0, 2.0 * wheels.radius[i]),
            )
            for i in range(len(wheels.names))
        ]
    )
    to_wheels = geometry.distances(np.zeros((len(configurations), 3)), configurations, boxes).min(
        axis=0
    )
    for part, row in zip(geometry.parts, to_wheels, strict=True):
        if part != PLATFORM:
            for name, distance in zip(wheels.names, row, strict=True):
                found[f"{name}_wheel", part] = float(distance)
    return found


def _configurations(description: DescriptionParameters) -> Array:
    """Return random postures (k, 6) of the arm within the limits of its joints [rad]."""
    low, high = (np.array(description.arm.each(label)) for label in ("lower", "upper"))
    return np.random.default_rng(SEED).uniform(low, high, (SAMPLES, JOINTS))
