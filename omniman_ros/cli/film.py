"""`omniman film`: draw a film of a drive from a recording."""

import argparse
from pathlib import Path
from typing import Any

from omniman_ros.cli.plot import choose_namespace
from omniman_ros.cli.urdf import robot_description
from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import say
from omniman_ros.core.errors import InputError
from omniman_ros.description.urdf import carries_arm
from omniman_ros.extras import FILM, RECORDING

MEGABYTE = 1_000_000  #: Number of bytes of a megabyte
WIDTH_STEP = 16  #: Unit of the width, so that the height at 16:9 is whole [px]


def run(args: argparse.Namespace) -> int:
    """Run `omniman film`; return 0 or raise CommandError."""
    for extra in (RECORDING, FILM):
        if not extra.is_available:
            raise CommandError(extra.hint)
    check_options(args)
    from omniman_ros.recording.film.film_log import read_film_log
    from omniman_ros.recording.film.shots import cut
    from omniman_ros.recording.reader import BagReader

    bag_path = Path(args.bag)
    try:
        with BagReader(bag_path) as bag:
            namespace = choose_namespace(bag.topic_types, args.namespace.strip("/"))
            say(f"{bag_path}: {bag.duration:.1f} s, {len(bag.topic_types)} topics")
            log = read_film_log(bag, namespace)
        shots = cut(log, args.duration)
    except InputError as error:
        raise CommandError(str(error)) from error
    for shot in shots:
        say(f"  {shot.kind:8} {shot.length:5.1f} s at {shot.speed:.1f}x")
    name = bag_path.stem if bag_path.is_file() else bag_path.resolve().name
    path = Path(args.output or f"{name}.webp")
    size = make_film(args, log, shots, path)
    say(f"Film: {path}, {sum(shot.on_screen for shot in shots):.1f} s, {size / MEGABYTE:.1f} MB")
    return 0


def check_options(args: argparse.Namespace) -> None:
    """Check the numbers of the command line; CommandError if one is out of range."""
    for name, low, high in (
        ("duration", 1.0, 300.0),
        ("rate", 1.0, 50.0),
        ("size", 0.05, 1000.0),
        ("width", 160, 3840),
    ):
        value = getattr(args, name)
        if not low <= value <= high:
            raise CommandError(f"--{name} must be {low:g} to {high:g}, got {value:g}", 2)
    if args.width % WIDTH_STEP:
        raise CommandError(f"--width must be a multiple of {WIDTH_STEP}, got {args.width}", 2)


def make_film(args: argparse.Namespace, log: Any, shots: list[Any], path: Path) -> int:
    """Draw and write the film; return its size [bytes].

    Raises:
        CommandError: The robot does not exist, the film is too large, or it cannot be written.
    """
    from omniman_ros.recording.film.encoding import write_film
    from omniman_ros.recording.film.film import Film, FilmFormat

    description = robot_description(args.robot, args.param, args.params_file)
    mount = description.mount if carries_arm(description.robot) else None
    form = FilmFormat((args.width, args.width * 9 // 16), args.rate)
    film = Film(log, shots, description.robot, mount, form)
    progress = Progress()
    progress.begin("drawing")
    frames = []
    for frame in film.frames():
        frames.append(frame)
        progress.update(len(frames) / film.frame_count, f"{len(frames)} frames")
    progress.end(f"{len(frames)} frames")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return write_film(
            frames,
            args.rate,
            path,
            round(args.size * MEGABYTE),
            lambda quality, size: say(f"  quality {quality}: {size / MEGABYTE:.2f} MB"),
        )
    except InputError as error:
        raise CommandError(f"{error}: lower --duration, --width or --rate") from error
    except OSError as error:
        raise CommandError(f"{path}: {error.strerror}") from error
