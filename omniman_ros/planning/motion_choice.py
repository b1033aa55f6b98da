"""The choice among motions of d coordinates: a new plan, the rest of the last motion, or braking.

The order of preference is: the longest part of a plan that is clear together with its braking, the
last motion, the longest clear part of the last motion. If no motion is clear, the one is followed
on which contact comes latest: the obstacles may still turn away, and an evasion may still be
found.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from omniman_ros.planning.motion import HermiteTrajectory

#: Time by which contact must come later for another motion to be better than braking now [s]
CONTACT_DELAY = 0.1
#: Increase of the smallest gap that makes a motion better if contact does not come sooner [m]
GAP_GAIN = 0.005
PREVIEW_DURATION = 0.4  #: Time for which a motion is sent ahead before it brakes [s]
HISTORY_TIME = 0.5  #: Length of the past part of a motion that is kept [s]
REST_SPAN = 1e-3  #: Shortest part of a motion that has ended [s]

#: Returns a motion that is followed up to a time [s], and then braked to rest
Brake = Callable[[HermiteTrajectory, float], HermiteTrajectory]
#: Does the same for each of several times [s]
Brakings = Callable[[HermiteTrajectory, Sequence[float]], Iterable[HermiteTrajectory]]


class MotionCheck(Protocol):
    """A check of motions from a time `now` [s] on, up to their end or longer."""

    def contact(self, motion: HermiteTrajectory, now: float) -> float:
        """Return the time from which a motion must not be followed [s]; infinity if it may."""

    def threat(self, motion: HermiteTrajectory, now: float) -> tuple[float, float]:
        """Rate a motion that is not clear: of two results, the greater one is better.

        Returns:
            Time at which the robot itself touches something [s], and the smallest gap [m].
        """


@dataclass(frozen=True)
class MotionChoice:
    """The motion to follow."""

    motion: HermiteTrajectory
    plan: int | None = None  #: Number of the plan that it follows or begins with, if any
    is_braking: bool = False  #: Whether the robot brakes as no other motion is clear, or better
    contact: float = math.inf  #: Time of the first contact [s]; infinity if it is clear
    is_clear: bool = True  #: Whether the motion may be followed to its end

    @property
    def is_evasion(self) -> bool:
        """Whether the robot moves on although no motion is clear."""
        return not self.is_clear and not self.is_braking


@dataclass(frozen=True)
class MotionChooser:
    """Chooses the motion to follow at a time.

    Args:
        check: What all motions are checked by.
        brake: How all motions are braked.
        now: Time from which motions are checked [s].
        ready: Time at which the choice takes over, from which the last motion may brake [s].
        attempts: Largest number of brakings of a motion that are tried, evenly spaced.
        brakings: How a motion is braked at several times, where that is cheaper together.
        evades_contact: Whether a motion that is not clear is followed as contact comes later on
            it than on braking; else only if it has no contact.
    """

    check: MotionCheck
    brake: Brake
    now: float
    ready: float
    attempts: int | None = None
    brakings: Brakings | None = None
    evades_contact: bool = True

    def choose(
        self,
        plans: Iterable[HermiteTrajectory],
        earliest: float,
        last: HermiteTrajectory,
        before: MotionChoice | None,
    ) -> MotionChoice:
        """Return the best motion.

        Args:
            plans: New plans by preference, each asked for as no other one before is clear; they
                begin with the last motion.
            earliest: Time from which plans may brake [s].
            last: Motion that is followed now.
            before: The choice before, as a robot that evades continues to do so.
        """
        tried: list[HermiteTrajectory] = []
        for k, plan in enumerate(plans):
            tried.append(plan)
            clear = self.longest(plan, earliest)
            if clear is not None:
                return MotionChoice(clear, k)
        if self.check.contact(last, self.now) == math.inf:
            return MotionChoice(last)
        rest = rest_of(last, self.now)
        clear = self.longest(rest, self.ready)
        if clear is not None:
            return MotionChoice(clear, is_braking=True)
        return self._latest_contact([*tried, rest], before is not None and before.is_evasion)

    def longest(self, motion: HermiteTrajectory, earliest: float) -> HermiteTrajectory | None:
        """Return the longest part of a motion that can be driven and then braked without contact.

        The motion need not end at rest; the braking begins at `earliest` [s] or later. None means
        that there is no such part.
        """
        whole = self.brake(motion, motion.end)
        contact = self.check.contact(whole, self.now)
        if contact == math.inf:
            return whole
        nodes = motion.times[(motion.times >= earliest) & (motion.times < contact)]
        if self.attempts is not None and len(nodes) > self.attempts:
            # The last ones are too late for a braking.
            nodes = nodes[np.linspace(0, len(nodes) - 1, self.attempts + 1)[:-1].astype(int)]
        # To brake earlier need not be safer if an obstacle comes from behind.
        begins = nodes[::-1].tolist()
        one_by_one = (self.brake(motion, begin) for begin in begins)
        for shorter in self.brakings(motion, begins) if self.brakings else one_by_one:
            if self.check.contact(shorter, self.now) == math.inf:
                return shorter
        return None

    def _latest_contact(
        self, candidates: Sequence[HermiteTrajectory], evades: bool
    ) -> MotionChoice:
        """Return braking, or a candidate on which contact comes later or the gap stays wider.

        The last candidate is the rest of the last motion, the others are plans.
        """
        # A robot that evades continues to do so: to alternate between motions makes no progress.
        required_delay = -CONTACT_DELAY if evades else CONTACT_DELAY
        rest = candidates[-1]
        motion = self.brake(rest, max(self.ready, rest.start))
        contact, gap = self.check.threat(motion, self.now)
        best = MotionChoice(motion, None, True, contact, False)
        for k, candidate in enumerate(candidates):
            motion = self.brake(candidate, candidate.end)
            new_contact, new_gap = self.check.threat(motion, self.now)
            if not self.evades_contact and new_contact < math.inf:
                continue
            if new_contact > contact + required_delay or (
                new_contact >= contact and new_gap > gap + GAP_GAIN
            ):
                contact, gap, required_delay = new_contact, new_gap, 0.0
                plan = k if candidate is not rest else None
                best = MotionChoice(motion, plan, False, contact, False)
        return best


def rest_of(motion: HermiteTrajectory, now: float) -> HermiteTrajectory:
    """Return a motion from `HISTORY_TIME` before now [s] to its end, or itself if it is that."""
    if motion.start >= now - HISTORY_TIME and motion.end >= now + REST_SPAN:
        return motion
    begins = max(motion.start, now - HISTORY_TIME)
    return motion.between(begins, max(motion.end, now + REST_SPAN))
