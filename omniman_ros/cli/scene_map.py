"""`omniman map`: write a scene as a map for Nav2's map server."""

import argparse
from pathlib import Path

import numpy as np
import yaml

from omniman_ros.console.errors import CommandError
from omniman_ros.console.files import output_errors
from omniman_ros.console.terminal import say
from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.scene_files import load_scene
from omniman_ros.simulation.world.occupancy import Occupancy, occupancy

OCCUPIED, FREE = 0, 254
"""Shades of the cells, as the map server writes them: black and nearly white."""


def run(args: argparse.Namespace) -> int:
    """Run `omniman map`; return 0 or raise CommandError."""
    stem = Path(args.output or Path(args.scene).stem)
    try:
        grid = occupancy(load_scene(args.scene), args.resolution, args.height)
    except ParameterError as error:
        raise CommandError(str(error), 2) from error
    picture, about = stem.with_suffix(".pgm"), stem.with_suffix(".yaml")
    description = {
        "image": picture.name,
        "mode": "trinary",
        "resolution": args.resolution,
        "origin": [*grid.origin.tolist(), 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.25,
    }
    with output_errors(args.output):
        stem.parent.mkdir(parents=True, exist_ok=True)
        picture.write_bytes(grey_map(grid))
        about.write_text(yaml.safe_dump(description, sort_keys=False), encoding="utf-8")
    say(f"{about} and {picture.name} written")
    return 0


def grey_map(grid: Occupancy) -> bytes:
    """Return a portable grey map (PGM) of a grid, whose last row comes first."""
    rows, columns = grid.occupied.shape
    shades = np.where(grid.occupied[::-1], OCCUPIED, FREE).astype(np.uint8)
    return f"P5\n{columns} {rows}\n255\n".encode() + shades.tobytes()
