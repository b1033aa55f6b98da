"""Tree of coordinate frames that are related by transforms over the last seconds.

The rules are those of tf2: a frame has one parent; between two samples of a moving frame it is
interpolated; before its first and after its last sample nothing is known of it.
"""

import math
from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import IDENTITY, Transform, demand_unit

ODOM = ""  #: Frame of what is placed in odom, by whatever name the odom frame goes
#: Age, relative to the newest sample of its frame, up to which a sample is kept [s]; as tf2
CACHE_TIME = 10.0
MAX_FRAMES = 1000  #: Largest number of frames; more are refused
MAX_SAMPLES = 5000  #: Largest number of samples of a frame; the oldest ones are dropped
MAX_DEPTH = 100  #: Largest number of frames between a frame and the root; a loop has more


class TransformError(InputError):
    """A frame cannot be transformed into another one; `may_come` if it still may arrive."""

    may_come = True


class UnknownFrameError(TransformError):
    """No transform names the frame."""


class NotConnectedError(TransformError):
    """Both frames are known, but no chain of transforms leads from one to the other."""


class FutureTransformError(TransformError):
    """The newest transform is older than the time asked for."""


class PastTransformError(TransformError):
    """The oldest transform that is kept is newer than the time asked for."""

    may_come = False


@dataclass(frozen=True, slots=True)
class Placement:
    """Place of coordinates in the world."""

    #: A frame that does not move with the robot: an ancestor of odom in the tree of transforms,
    #: such as `map`; empty for odom itself.
    frame: str
    transform: Transform = IDENTITY  #: Transform of the coordinates into that frame


@dataclass(slots=True)
class _Frame:
    parent: str  #: Name of the parent
    is_static: bool  #: Whether the first transform holds for ever
    times: list[float] = field(default_factory=list)  #: Times of the transforms [s], increasing
    #: Transforms that take coordinates of the frame to its parent
    transforms: list[Transform] = field(default_factory=list)
    updated: float = -math.inf  #: Time of the newest transform, at most that of its arrival [s]

    def insert(self, time: float, transform: Transform, now: float) -> None:
        """Add a sample; one that is too old, or has the time of another one, is ignored."""
        self.updated = max(self.updated, min(time, now))
        if not self.times or time > self.times[-1]:
            self.times.append(time)
            self.transforms.append(transform)
        else:
            i = bisect_left(self.times, time)
            if self.times[i] == time or time < self.times[-1] - CACHE_TIME:
                return
            self.times.insert(i, time)
            self.transforms.insert(i, transform)
        # Samples go in blocks: to remove the first of a list costs as much as its length.
        if len(self.times) > MAX_SAMPLES or self.times[0] < self.times[-1] - 2.0 * CACHE_TIME:
            first = bisect_left(self.times, self.times[-1] - CACHE_TIME)
            first = max(first, len(self.times) - MAX_SAMPLES // 2)
            del self.times[:first], self.transforms[:first]

    def at(self, time: float | None, name: str) -> Transform:
        """Return the transform at a time [s], or the newest one for None."""
        if self.is_static or time is None:
            return self.transforms[-1]
        times = self.times
        if time > times[-1]:
            lead = time - times[-1]
            raise FutureTransformError(
                f"the newest transform from '{name}' to '{self.parent}' is {lead:.3f} s older"
            )
        if time < times[0] or time < times[-1] - CACHE_TIME:
            lag = max(times[0], times[-1] - CACHE_TIME) - time
            raise PastTransformError(
                f"the transforms from '{name}' to '{self.parent}' begin {lag:.3f} s later"
            )
        i = bisect_left(times, time)
        if times[i] == time:
            return self.transforms[i]
        fraction = (time - times[i - 1]) / (times[i] - times[i - 1])
        return self.transforms[i - 1].interpolated(self.transforms[i], fraction)


class TransformTree:
    """Frames and their transforms of the last `CACHE_TIME` seconds."""

    def __init__(self) -> None:
        self._frames: dict[str, _Frame] = {}

    def __bool__(self) -> bool:
        return bool(self._frames)

    def clear(self, *, keep_static: bool = True) -> None:
        """Forget the transforms; by default those that hold for ever are kept."""
        self._frames = {
            name: frame for name, frame in self._frames.items() if keep_static and frame.is_static
        }

    def insert(
        self,
        parent: str,
        child: str,
        time: float,
        transform: Transform,
        *,
        is_static: bool,
        now: float = math.inf,
    ) -> None:
        """Add a transform that takes coordinates of `child` to `parent`.

        A frame that gets another parent leaves the former one; with it, its history is lost.

        Args:
            time: Time of the transform [s]; of no meaning for one that holds for ever.
            now: Time of its arrival [s]: one that is dated ahead is no younger than that.

        Raises:
            InputError: A name is empty, or both are the same; a number is not finite or not
                plausible; the rotation is not of unit length; or there are too many frames.
        """
        _check(parent, child, time, transform)
        known = self._frames.get(child)
        if known is None and len(self._frames) >= MAX_FRAMES:
            raise InputError(f"there are {MAX_FRAMES} frames already")
        if known is None or known.parent != parent or known.is_static or is_static:
            known = self._frames[child] = _Frame(parent, is_static)
        known.insert(time, _normalised(transform), now)

    def lookup(self, target: str, source: str, time: float | None) -> Transform:
        """Return the transform that takes coordinates of `source` to `target`.

        Args:
            time: Time at which the transform holds [s]; None for the newest one of each frame.

        Raises:
            TransformError: There is none; the subclass says why.
        """
        if source == target:
            return IDENTITY
        up, down = self._chain(source), self._chain(target)
        common = self._common(up, down, source, target)
        return self._to_ancestor(down, common, time).inverse @ self._to_ancestor(up, common, time)

    def ancestor(self, first: str, second: str) -> str:
        """Return the name of the nearest frame from which both frames descend, or one of them.

        Raises:
            TransformError: A frame is not known, or they are not connected.
        """
        if first == second:
            return first
        return self._common(self._chain(first), self._chain(second), first, second)

    def updated(self, target: str, source: str) -> float:
        """Return the time since which the newest transform between two frames may be old [s].

        That is the time of the newest sample, at most that of its arrival, of the frame on the way
        that was longest silent;
        infinity if all transforms hold for ever.

        Raises:
            TransformError: A frame is not known, or they are not connected.
        """
        up, down = self._chain(source), self._chain(target)
        common = self._common(up, down, source, target)
        way = [*up[: up.index(common)], *down[: down.index(common)]]
        moving = (self._frames[name] for name in way if not self._frames[name].is_static)
        return min((frame.updated for frame in moving), default=math.inf)

    def is_child(self, name: str) -> bool:
        """Return whether a frame has a parent."""
        return name in self._frames

    def _chain(self, name: str) -> list[str]:
        chain = [name]
        while (frame := self._frames.get(chain[-1])) is not None:
            chain.append(frame.parent)
            if len(chain) > MAX_DEPTH:
                raise NotConnectedError(f"the parents of frame '{name[:40]}' form a loop")
        return chain

    def _common(self, up: list[str], down: list[str], source: str, target: str) -> str:
        ancestors = set(down)
        for name in up:
            if name in ancestors:
                return name
        for name in (source, target):
            if not self._is_known(name):
                raise UnknownFrameError(f"no transform of frame '{name[:40]}' was received")
        raise NotConnectedError(
            f"no transforms connect frame '{source[:40]}' with '{target[:40]}'"
        )

    def _is_known(self, name: str) -> bool:
        return name in self._frames or any(f.parent == name for f in self._frames.values())

    def _to_ancestor(self, chain: Iterable[str], ancestor: str, time: float | None) -> Transform:
        result = Transform()
        for name in chain:
            if name == ancestor:
                break
            result = self._frames[name].at(time, name) @ result
        return result


def _check(parent: str, child: str, time: float, transform: Transform) -> None:
    """Check a transform that comes in."""
    if not parent or not child or parent == child:
        raise InputError(f"it has frames '{parent[:40]}' and '{child[:40]}'")
    plausible.demand(np.array(transform.translation), plausible.LENGTH, "translation")
    demand_unit(transform.rotation)
    if not math.isfinite(time):
        raise InputError(f"it has the time {time}")


def _normalised(transform: Transform) -> Transform:
    x, y, z, w = transform.rotation
    length = math.hypot(*transform.rotation)
    rotation = (x / length, y / length, z / length, w / length)
    return Transform(transform.translation, rotation)
