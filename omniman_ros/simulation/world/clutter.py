"""Random posts on a field, after the BARN benchmark of navigation in clutter.

Source: D. Perille, A. Truong, X. Xiao and P. Stone, "Benchmarking Metric Ground Navigation"
(2020): cylinders on a field between two walls, placed by a cellular automaton. Here they are
placed independently, but not in a winding channel of a given width, so that there is always a way
from end to end.
"""

import math
import random
from dataclasses import dataclass

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import REQUIRED, parameter
from omniman_ros.simulation.world.scene import Element, Post


@dataclass(frozen=True, kw_only=True)
class Clutter(Element):
    """A field of random posts with a free channel, along x from `x_min` to `x_max`.

    Raises:
        ParameterError: The field is empty or the channel wider than the field; see also
            :class:`Element`.
    """

    seed: int = parameter(0, "Seed of the field.", low=0)
    count: int = parameter(60, "Number of posts that are tried.", low=0, high=2000)
    x_min: float = parameter(REQUIRED, "Field, x from.", unit="m", low=-1000, high=1000)
    x_max: float = parameter(REQUIRED, "Field, x to.", unit="m", low=-1000, high=1000)
    y_min: float = parameter(REQUIRED, "Field, y from.", unit="m", low=-1000, high=1000)
    y_max: float = parameter(REQUIRED, "Field, y to.", unit="m", low=-1000, high=1000)
    radius: float = parameter(0.075, "Radius of the posts.", unit="m", low=0.005, high=10)
    height: float = parameter(1.0, "Height of the posts.", unit="m", low=0.01, high=100)
    channel: float = parameter(1.6, "Width of the free channel.", unit="m", low=0, high=100)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.x_min < self.x_max or not self.y_min < self.y_max:
            raise ParameterError(f"{self.name}.x_max", self.x_max, "the field is empty")
        if self.channel > self.y_max - self.y_min:
            raise ParameterError(f"{self.name}.channel", self.channel, "is wider than the field")


def clutter_posts(field: Clutter) -> tuple[Post, ...]:
    """Return the posts of a field; the same field always has the same posts."""
    generator = random.Random(field.seed)
    length = field.x_max - field.x_min
    room = 0.5 * (field.y_max - field.y_min - field.channel)
    middle = 0.5 * (field.y_min + field.y_max)
    waves = [
        (generator.uniform(-1.0, 1.0) / k, math.pi * k, generator.uniform(0.0, math.tau))
        for k in (1, 2, 3)
    ]
    largest = sum(abs(wave[0]) for wave in waves) or 1.0

    def channel(x: float) -> float:
        at = (x - field.x_min) / length
        return middle + room / largest * sum(a * math.sin(w * at + p) for a, w, p in waves)

    posts: list[Post] = []
    free = 0.5 * field.channel + field.radius
    for k in range(field.count):
        x = generator.uniform(field.x_min, field.x_max)
        y = generator.uniform(field.y_min, field.y_max)
        samples = (x + free * i / 8 for i in range(-8, 9))
        if min(math.hypot(s - x, channel(s) - y) for s in samples) < free:
            continue
        name = f"{field.name}_{k}"
        posts.append(Post(name=name, x=x, y=y, radius=field.radius, height=field.height))
    return tuple(posts)
