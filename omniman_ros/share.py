"""Locate the files that are shared with users: robots, launch files, models, views."""

import sys
from collections.abc import Iterator
from pathlib import Path

NAME = "omniman_ros"


def share_path(*parts: str) -> Path:
    """Return the path of a shared file or folder, for any kind of installation.

    It is searched in the source tree (an editable installation has no other copy), then in the
    prefix of this module and that of the interpreter (pip, colcon), then in the ament index.

    Args:
        parts: Folders and name below `share/omniman_ros`, for example "config", "omniman.yaml".

    Raises:
        FileNotFoundError: It is in none of these places, which the message lists.
    """
    tried = []
    for path in _places(Path(__file__).resolve(), parts):
        if path.exists():
            return path
        tried.append(str(path))
    raise FileNotFoundError(f"no '{'/'.join(parts)}' of {NAME}; looked for {', '.join(tried)}")


def _places(module: Path, parts: tuple[str, ...]) -> Iterator[Path]:
    """Yield the places to search, in order."""
    root = module.parents[1]
    if (root / "package.xml").is_file():
        yield _in_source_tree(root, parts)
    above_lib = [folder.parent for folder in module.parents if folder.name == "lib"]
    for prefix in dict.fromkeys([*above_lib, root, Path(sys.prefix)]):
        yield prefix.joinpath("share", NAME, *parts)
    for share in _ament_share():
        yield share.joinpath(*parts)


def _in_source_tree(root: Path, parts: tuple[str, ...]) -> Path:
    """Return the path in the repository, whose config/ contains launch/, urdf/ and rviz/."""
    if parts[:1] == ("config",):
        return root.joinpath(*parts)
    return root.joinpath("config", *parts)


def _ament_share() -> Iterator[Path]:
    """Yield the share folder in the ament index, if there is an index that has one."""
    try:
        from ament_index_python.packages import get_package_share_directory

        share = get_package_share_directory(NAME)
    except (ImportError, OSError, LookupError):
        # ROS is not installed, AMENT_PREFIX_PATH is not set, or the installation has no marker.
        return
    yield Path(share)
