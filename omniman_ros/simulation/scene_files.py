"""Scenes from files: config/worlds/NAME.yaml."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from omniman_ros.core.errors import FileError, ParameterError
from omniman_ros.core.parameters import renamed, specs
from omniman_ros.share import share_path
from omniman_ros.simulation.world.clutter import Clutter, clutter_posts
from omniman_ros.simulation.world.scene import (
    Column,
    Crate,
    Element,
    Load,
    Pallet,
    Person,
    Post,
    Scene,
    Table,
    Wall,
)
from omniman_ros.yaml_files import read_yaml

KINDS: dict[str, type[Element]] = {
    "walls": Wall,
    "posts": Post,
    "columns": Column,
    "tables": Table,
    "pallets": Pallet,
    "crates": Crate,
    "loads": Load,
    "persons": Person,
    "clutter": Clutter,
}  #: Kind of the elements of each list in a file
START = "start"  #: Key of the robot's start: x, y, heading [m, m, rad]
E = TypeVar("E", bound=Element)  #: Kind of an element


def scene_file(name: str) -> Path:
    """Return the path of a scene's file.

    Args:
        name: Name of a file in config/worlds/ without its suffix, or the path of a YAML file.

    Raises:
        ParameterError: There is no such file; the message lists the names in config/worlds/.
    """
    path = Path(name).expanduser()
    if path.suffix in (".yaml", ".yml"):
        if path.is_file():
            return path
        raise ParameterError("scene", name, "there is no such file")
    folder = share_path("config", "worlds")
    named = folder / f"{name}.yaml"
    if name and named.parent == folder and named.is_file():
        return named
    known = ", ".join(sorted(file.stem for file in folder.glob("*.yaml")))
    raise ParameterError("scene", name, f"must be one of {known}, or the path of a .yaml file")


def load_scene(name: str) -> Scene:
    """Read a scene.

    Raises:
        ParameterError: There is no such file, it is no YAML file of lists of elements, or an
            element is refused.
    """
    path = scene_file(name)
    try:
        tree = read_yaml(path)
    except FileError as error:
        raise ParameterError("scene", name, str(error)) from error
    tree = {} if tree is None else tree
    return scene_of(tree, path.name)


def scene_of(tree: object, source: str) -> Scene:
    """Build a scene from a mapping: `start`, and a list of elements for each of :data:`KINDS`.

    Raises:
        ParameterError: The content is no such mapping, or an element is refused.
    """
    if not isinstance(tree, Mapping) or not set(tree) <= {START, *KINDS}:
        allowed = ", ".join((START, *KINDS))
        raise ParameterError("scene", source, f"must be a mapping with keys among {allowed}")
    elements: dict[str, tuple[Any, ...]] = {
        kind: tuple(_element(cls, entry, source) for entry in _list(tree, kind, source))
        for kind, cls in KINDS.items()
    }
    fields = elements.pop("clutter")
    posts = [post for field in fields for post in clutter_posts(field)]
    elements["posts"] += tuple(posts)
    return Scene(start=_start(tree.get(START, [0, 0, 0]), source), **elements)


def _start(value: object, source: str) -> tuple[float, float, float]:
    if not isinstance(value, list) or len(value) != 3:
        raise ParameterError(START, value, f"must be x, y and heading in {source}")
    x, y, heading = value
    return x, y, heading


def _list(tree: Mapping[str, Any], kind: str, source: str) -> list[Any]:
    entries = tree.get(kind) or []
    if not isinstance(entries, list):
        raise ParameterError(kind, entries, f"must be a list in {source}")
    return entries


def _element(cls: type[E], entry: object, source: str) -> E:
    known = [spec.name for spec in specs(cls)]
    if not isinstance(entry, Mapping) or not set(entry) <= set(known):
        allowed = ", ".join(known)
        raise ParameterError(source, entry, f"must be a mapping with keys among {allowed}")
    required = {spec.name for spec in specs(cls) if spec.required}
    if missing := required - set(entry):
        raise ParameterError(source, entry, f"must have {', '.join(sorted(missing))}")
    with renamed(cls, f"{entry['name']}."):
        return cls(**dict(entry))
