"""How a distribution is installed, and which of its requirements are: from metadata, no ROS."""

import json
import os
import re
import subprocess
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution, version
from pathlib import Path

NAME = "omniman_ros"
GIT_TIMEOUT = 5.0  #: Time that git may take [s]

_REQUIREMENT = re.compile(r"[\w.-]+")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([\w.-]+)['\"]")
_ROS_WHEEL = re.compile(r"ros-([a-z]+)-rclpy")
#: File by which colcon marks what it has installed, below the prefix
_COLCON_MARKER = Path("share", "colcon-core", "packages", NAME)


@dataclass(frozen=True)
class Requirements:
    """What a distribution requires: names of distributions."""

    always: tuple[str, ...]
    extras: Mapping[str, tuple[str, ...]]  #: By the name of the extra

    @property
    def ros_wheels(self) -> dict[str, str]:
        """Name of the wheel with rclpy by that of the ROS distribution."""
        names = [name for group in self.extras.values() for name in group]
        matches = [_ROS_WHEEL.fullmatch(name) for name in names]
        return {match[1]: match[0] for match in matches if match}


def parse_requirements(lines: Iterable[str], extras: Iterable[str] = ()) -> Requirements:
    """Sort the lines `Requires-Dist` of a distribution by the extras that they belong to.

    Args:
        extras: Names of all extras, some of which may require nothing.
    """
    always: list[str] = []
    groups: dict[str, list[str]] = {name: [] for name in extras}
    for line in lines:
        name, extra = _REQUIREMENT.match(line.strip()), _EXTRA.search(line)
        if name is not None:
            group = always if extra is None else groups.setdefault(extra[1], [])
            group.append(name[0])
    return Requirements(tuple(always), {key: tuple(names) for key, names in groups.items()})


def installed_version(name: str) -> str | None:
    """Return the version of a distribution; None if it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def extra_text(
    names: Iterable[str], version_of: Callable[[str], str | None] = installed_version
) -> str:
    """Return whether all distributions of an extra are installed, or which are missing."""
    versions = {name: version_of(name) for name in names}
    missing = [name for name, found in versions.items() if found is None]
    if missing:
        return f"missing: {', '.join(missing)}"
    return f"installed: {', '.join(f'{name} {found}' for name, found in versions.items())}"


def own_distribution() -> Distribution | None:
    """Return the metadata of this package; None where it runs without an installation."""
    try:
        return distribution(NAME)
    except PackageNotFoundError:
        return None


def commit_text(folder: Path) -> str:
    """Return the commit of the checkout with a package's folder; `-dirty`: files were changed."""
    if not (folder.parent / ".git").exists():  # that of an environment around it does not count
        return "none: no git checkout"
    command = ("git", "-C", str(folder), "describe", "--always", "--dirty", "--exclude=*")
    try:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=GIT_TIMEOUT)
    except (OSError, subprocess.TimeoutExpired):
        return "unknown: git does not run"
    return ended.stdout.strip() if ended.returncode == 0 else "unknown: git refuses"


def installation_text(found: Distribution | None, environment: Mapping[str, str]) -> str:
    """Return by what a distribution was installed, and where: colcon, or pip's two ways."""
    if found is None:
        return "not installed: it runs from its source tree"
    place = Path(str(found.locate_file("")))
    origin = found.read_text("direct_url.json")
    is_of_pip = found.read_text("WHEEL") is not None
    for prefix in () if is_of_pip else _prefixes(place, environment):
        if (prefix / _COLCON_MARKER).is_file():
            return f"by colcon, in {prefix}"
    source = json.loads(origin) if origin else {}
    if source.get("dir_info", {}).get("editable"):
        return f"editable, from {source['url']}"
    return f"{'wheel' if is_of_pip else 'by setuptools'}, in {place}"


def _prefixes(place: Path, environment: Mapping[str, str]) -> list[Path]:
    """Return where colcon may have put a distribution; a symbolic installation is elsewhere."""
    named = environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [*place.parents, *(Path(prefix) for prefix in named if prefix)]
