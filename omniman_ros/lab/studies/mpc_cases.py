"""The test cases of MPC 2021, section 4, and the variants in which they are driven.

Starts, goals and obstacles are those of `omniman_ros.planning.cases`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.mpc_loop import MovingObstacle
from omniman_ros.lab.studies.scene_geometry import Wall
from omniman_ros.planning.cases import CASES, RADIUS, Case, Pose
from omniman_ros.planning.obstacles.grid_map import GridMap

PAPER_HORIZON: Mapping[str, Any] = {
    "horizon.steps": 10,
    "horizon.step": 0.1,
    "weights.running": 0.0,
}
"""Parameters of the paper's horizon: n = 10 stages of 0.1 s, and no running cost, so that (31)
counts at the end only. Limits and a clipped goal remain."""


@dataclass(frozen=True)
class Scene:
    """A test case: start, goal, and the fixed and moving obstacles between them.

    Attributes:
        snapshots: Times at which figures show the drive, counted from when the goal was sent [s].
        changes: Parameters of the planner that differ from the robot's, full names to values.
        grid: Map of the walls that the planner receives; None if it receives no map.
    """

    name: str  # name of the case
    goal: Pose  # pose of the goal in odom [m, m, rad]
    start: Pose = (0.0, 0.0, 0.0)  # pose of the start in odom [m, m, rad]
    obstacles: tuple[MovingObstacle, ...] = ()  # obstacles as they truly are
    snapshots: tuple[float, ...] = ()
    changes: Mapping[str, Any] = field(default_factory=dict)
    noise: float = 0.0  # standard deviation of the observed positions of obstacles [m]
    time_limit: float = 30.0  # time within which the goal must be reached [s]
    walls: tuple[Wall, ...] = ()  # walls; touching one counts as a contact
    grid: GridMap | None = None


def circle(radius: float, place: Callable[[float], Array]) -> MovingObstacle:
    """Return a circular obstacle.

    Args:
        place: Function from a time [s] to the position (2,) of its centre in odom [m].
    """
    return MovingObstacle((radius, radius), place)


def _scene(case: Case, **more: Any) -> Scene:
    """Return the scene of a test case; `more` contains further fields of `Scene`."""
    circles = tuple(circle(RADIUS, path) for path in case.ways)
    return Scene(case.name, case.goal, case.start, circles, **more)


def free() -> Scene:
    """Return the free case, which has no obstacles (MPC 2021, 4.1)."""
    return _scene(CASES["free"], snapshots=(2.0, 3.5, 7.0))


def corridor() -> Scene:
    """Return the corridor: a row of circles that the robot passes lengthwise (MPC 2021, 4.2)."""
    return _scene(CASES["corridor"], snapshots=(0.8, 1.9, 2.7, 3.4, 4.8))


def moving() -> Scene:
    """Return the case of circles that cross the path, observed with noise (MPC 2021, 4.3)."""
    return _scene(CASES["moving"], noise=0.01)


SCENES: Mapping[str, Callable[[], Scene]] = {"free": free, "corridor": corridor, "moving": moving}
"""Functions that return the scenes of the test cases, by name."""


@dataclass(frozen=True)
class Variant:
    """A setting in which a case is driven.

    Attributes:
        robot: Changed parameters of robot and plant, full names to values.
        planner: Changed parameters of the planner, full names to values.
        voltages: Whether the planner's motor voltages are applied to the motors, instead of its
            reference being followed by the controller.
    """

    about: str  # short description, which names the drive in the results
    robot: Mapping[str, Any] = field(default_factory=dict)
    planner: Mapping[str, Any] = field(default_factory=dict)
    voltages: bool = False
