"""A drive of `BodyLoop`, judged by the ground truth: gaps, contacts, the tool's error."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.lab.measurement import columns_at
from omniman_ros.lab.studies.avoidance_scenes import AvoidanceScene, SceneGenerator
from omniman_ros.lab.studies.body_loop import BodyRecord
from omniman_ros.simulation.world.distances import ConfigurationDistances

STEP = 0.025  #: Time between two looks at the distances [s]
REACH = 1.0  #: Largest distance that is measured [m]
#: Speed of platform [m/s, with half of rad/s] or joints [rad/s] from which on a robot moves
MOVING = 0.02


@dataclass(frozen=True)
class JudgedBody(Validated):
    """What truly happened in a drive; times are those of the scene.

    The tool's error is that of the true joints and the odometry, against where the tool is to be
    at that time.
    """

    times: Annotated[Array, Shape("k")]  #: Times of axes, gaps and contacts [s]
    axes: Annotated[Array, Shape("k", 9)]  #: True axes [m, rad]
    tool: Annotated[Array, Shape("k", 3)]  #: True positions of the tool [m]
    gaps: Annotated[Array, Shape("k", "M")]  #: Gaps to what is in the scene, up to `REACH` [m]
    touches: Annotated[Array, Shape("k")]  #: 1 where something touches the robot, else 0
    cycles: Annotated[Array, Shape("n")]  #: Times of the arm's cycles [s]
    due: Annotated[Array, Shape("n", 3)]  #: Where the tool is to be, in odom [m]
    off: Annotated[Array, Shape("n")]  #: Error of the tool [m]
    stop: str  #: Why the robot stopped early, if it did
    completed_at: float | None  #: Time at which the tool rested at the end of its path [s]

    def contacts(self, *, at_rest: bool = False) -> list[float]:
        """Return the times at which something begins to touch a robot that moves, or rests."""
        rates = np.abs(np.gradient(self.axes, STEP, axis=0))
        base = np.hypot(rates[:, 0], rates[:, 1]) + 0.5 * rates[:, 2]
        moves = np.maximum(base, rates[:, 3:].max(axis=1)) > MOVING
        begins = np.diff(self.touches, prepend=0.0) > 0.0
        found: list[float] = self.times[begins & (moves != at_rest)].tolist()
        return found

    def speeds(self) -> Array:
        """Return the tool's speeds (n,) along its path, at the arm's cycles [m/s]."""
        rates = np.gradient(self.due, self.cycles, axis=0)
        result: Array = np.linalg.norm(rates, axis=1)
        return result

    @property
    def least_gap(self) -> float:
        """Least gap to anything in the scene, `REACH` where there is nothing [m]."""
        return float(self.gaps.min(initial=REACH))

    @property
    def rms(self) -> float:
        """Root mean square of the tool's error [m]."""
        return float(np.sqrt((self.off**2).mean()))


def judged(generator: SceneGenerator, scene: AvoidanceScene, record: BodyRecord) -> JudgedBody:
    """Return a drive as it truly was."""
    arm, platform = np.array(record.arm), np.array(record.platform)
    arm = arm[arm[:, 0] >= 0.0]
    odom = np.hstack([columns_at(platform[:, :4], arm[:, 0]), arm[:, 1:7]])
    off = generator.model.forward(odom)[:, :3, 3] - arm[:, 7:]
    times = np.arange(0.0, arm[-1, 0], STEP)
    true = np.column_stack([platform[:, 0], platform[:, 4:]])
    axes = np.hstack([columns_at(true, times), columns_at(arm[:, :7], times)])
    distances = ConfigurationDistances(generator.setup.description, scene.things)
    gaps = np.full((len(times), len(scene.things)), REACH)
    for k, now in enumerate(times.tolist() if scene.things else ()):
        distances.place(axes[k, :3], axes[k, 3:], scene.places_at(now))
        gaps[k] = distances.distances(REACH)
    touches = gaps.min(axis=1, initial=REACH) <= 0.0
    felt = [at for at, _ in record.contacts if 0.0 <= at < times[-1]]
    touches[np.searchsorted(times, felt)] = True
    return JudgedBody(
        times=times,
        axes=axes,
        tool=generator.model.forward(axes)[:, :3, 3],
        gaps=gaps,
        touches=touches.astype(float),
        cycles=arm[:, 0],
        due=arm[:, 7:],
        off=np.linalg.norm(off, axis=1),
        stop=record.stop,
        completed_at=record.completed_at,
    )
