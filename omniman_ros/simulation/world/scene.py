"""Scenes: what stands, lies and walks around the robot, as data.

Positions are in the world, the frame of the ground truth; x and y are arrays where an element has
several points. What carries a name can be a party of a contact.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, fields

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import REQUIRED, parameter
from omniman_ros.core.validated import Validated

Floats = tuple[float, ...]  #: Coordinates of points [m]
SCRIPTED = "scripted"  #: Behaviour of a person who gives way to nobody
REACTIVE = "reactive"  #: Behaviour of a person who keeps clear of everything
EXTENT = 1000.0  #: Largest coordinate [m]


def _coordinate(doc: str = "Position of the centre, x.") -> float:
    value: float = parameter(REQUIRED, doc, unit="m", low=-EXTENT, high=EXTENT)
    return value


def _length(default: float, doc: str, low: float = 0.01) -> float:
    value: float = parameter(default, doc, unit="m", low=low, high=EXTENT)
    return value


def _yaw() -> float:
    value: float = parameter(0.0, "Rotation about the vertical.", unit="rad", low=-7, high=7)
    return value


def _mass(default: float) -> float:
    value: float = parameter(default, "Mass.", unit="kg", low=0.01, high=10000)
    return value


@dataclass(frozen=True, kw_only=True)
class Element(Validated):
    """Part of a scene; a value of a wrong type or range raises a ParameterError."""

    name: str = parameter(REQUIRED, "Name of this element only.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.name or not self.name.isprintable():
            raise self._refusal("name", "must have printable characters")


@dataclass(frozen=True, kw_only=True)
class Wall(Element):
    """A wall along straight lines from point to point, with door openings.

    Raises:
        ParameterError: There are fewer than two points, two in a row coincide, or a door does not
            lie on the wall; see also :class:`Element`.
    """

    x: Floats = parameter(REQUIRED, "Points of the wall, x.", unit="m", low=-EXTENT, high=EXTENT)
    y: Floats = parameter(REQUIRED, "Points of the wall, y.", unit="m", low=-EXTENT, high=EXTENT)
    height: float = _length(2.0, "Height.")
    thickness: float = _length(0.1, "Thickness.")
    doors: Floats = parameter(
        (), "Centres of the doors, as distances from the first point along the wall.", unit="m"
    )
    door_width: float = _length(0.9, "Width of each door opening.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.x) < 2 or len(self.x) != len(self.y):
            raise self._refusal("x", "must be two or more points with y")
        lengths = [
            ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5
            for x0, y0, x1, y1 in zip(self.x, self.y, self.x[1:], self.y[1:], strict=False)
        ]
        if min(lengths) <= 0.0:
            raise self._refusal("x", "has the same point twice in a row")
        for door in self.doors:
            if not 0.0 <= door <= sum(lengths):
                reason = f"must be on the wall, from 0 to {sum(lengths):g} m"
                raise self._refusal("doors", f"{door:g} {reason}")


@dataclass(frozen=True, kw_only=True)
class Post(Element):
    """An upright cylinder that stands fixed."""

    x: float = _coordinate("Position of the axis, x.")
    y: float = _coordinate("Position of the axis, y.")
    radius: float = _length(0.1, "Radius.", low=0.005)
    height: float = _length(2.0, "Height.")


@dataclass(frozen=True, kw_only=True)
class Column(Element):
    """An upright column with an elliptic outline that stands fixed."""

    x: float = _coordinate("Position of the axis, x.")
    y: float = _coordinate("Position of the axis, y.")
    yaw: float = _yaw()
    length: float = _length(0.4, "Diameter of the ellipse along x at a yaw of zero.")
    width: float = _length(0.2, "Diameter of the ellipse across it.")
    height: float = _length(2.0, "Height.")


@dataclass(frozen=True, kw_only=True)
class Table(Element):
    """A table top on four legs at its corners, fixed to the floor.

    Raises:
        ParameterError: The top is thicker than the table is high; see also :class:`Element`.
    """

    x: float = _coordinate()
    y: float = _coordinate("Position of the centre, y.")
    yaw: float = _yaw()
    length: float = _length(1.6, "Length of the top, along x at a yaw of zero.")
    width: float = _length(0.8, "Width of the top.")
    height: float = _length(0.75, "Height of the top's upper side.")
    thickness: float = _length(0.03, "Thickness of the top.", low=0.005)
    leg: float = _length(0.05, "Edge of the square legs.", low=0.005)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.thickness < self.height:
            raise self._refusal("thickness", "must be below height")


@dataclass(frozen=True, kw_only=True)
class Pallet(Element):
    """A loaded pallet, too heavy to be moved; the sizes are those of EN 13698-1 without load."""

    x: float = _coordinate()
    y: float = _coordinate("Position of the centre, y.")
    yaw: float = _yaw()
    length: float = _length(1.2, "Length, along x at a yaw of zero.")
    width: float = _length(0.8, "Width.")
    height: float = _length(0.144, "Height, with its load.")


@dataclass(frozen=True, kw_only=True)
class Crate(Element):
    """A box on the floor that can be pushed, and falls."""

    x: float = _coordinate()
    y: float = _coordinate("Position of the centre, y.")
    yaw: float = _yaw()
    length: float = _length(0.6, "Length, along x at a yaw of zero.")
    width: float = _length(0.4, "Width.")
    height: float = _length(0.32, "Height.")
    mass: float = _mass(10.0)


@dataclass(frozen=True, kw_only=True)
class Load(Element):
    """A box that lies loose on the platform; x, y and yaw are in base_link."""

    x: float = _coordinate("Position of the centre in base_link, forward.")
    y: float = _coordinate("Position of the centre in base_link, left.")
    yaw: float = _yaw()
    length: float = _length(0.3, "Length, forward at a yaw of zero.")
    width: float = _length(0.3, "Width.")
    height: float = _length(0.2, "Height.")
    mass: float = _mass(10.0)


@dataclass(frozen=True, kw_only=True)
class Person(Element):
    """A person who walks from way point to way point in a cycle, or stands at a single one.

    A scripted person gives way to nobody. A reactive one keeps clear of the robot, of what is
    fixed or lies about, and of other persons.

    Raises:
        ParameterError: x and y differ in length or are empty; see also :class:`Element`.
    """

    x: Floats = parameter(REQUIRED, "Way points, x.", unit="m", low=-EXTENT, high=EXTENT)
    y: Floats = parameter(REQUIRED, "Way points, y.", unit="m", low=-EXTENT, high=EXTENT)
    behaviour: str = parameter(
        SCRIPTED, "Whether the person gives way.", choices=(SCRIPTED, REACTIVE)
    )
    speed: float = parameter(1.0, "Walking speed.", unit="m/s", low=0.01, high=5)
    clearance: float = parameter(
        0.15, "Distance that a reactive person keeps.", unit="m", low=0, high=5
    )
    radius: float = _length(0.25, "Radius.", low=0.05)
    height: float = _length(1.7, "Height.", low=0.5)
    mass: float = _mass(75.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.x or len(self.x) != len(self.y):
            raise self._refusal("x", "must be one or more points with y")


@dataclass(frozen=True, kw_only=True)
class Scene(Validated):
    """What is around the robot, and where the robot starts.

    Raises:
        ParameterError: The start is not three finite numbers, or two elements have the same name.
    """

    start: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: Pose of base_link [m, m, rad]
    walls: tuple[Wall, ...] = ()
    posts: tuple[Post, ...] = ()
    columns: tuple[Column, ...] = ()
    tables: tuple[Table, ...] = ()
    pallets: tuple[Pallet, ...] = ()
    crates: tuple[Crate, ...] = ()  #: What can be pushed
    loads: tuple[Load, ...] = ()  #: What lies on the platform
    persons: tuple[Person, ...] = ()  #: Who walks or stands there

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, count in Counter(element.name for element in self.elements()).items():
            if count > 1:
                raise ParameterError("name", name, "two elements of the scene have this name")

    def elements(self) -> Iterator[Element]:
        """Yield all elements."""
        for entry in fields(self)[1:]:
            yield from getattr(self, entry.name)
