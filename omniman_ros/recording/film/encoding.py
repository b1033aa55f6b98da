"""Writing of frames as an animated WebP file of bounded size.

Importing this module raises ImportError where Pillow is not installed.
"""

import io
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from omniman_ros.core.errors import InputError

#: Qualities of the compression that are tried, the best one first
QUALITIES = (80, 70, 60, 50, 40, 30, 20, 10)
EFFORT = 4  #: Effort of the compression, 0 to 6: more takes longer and saves space
LAST_FRAME = 1.5  #: Time for which the last frame is shown before the film begins again [s]


def write_film(
    frames: Sequence[Any],
    rate: float,
    path: Path,
    most_bytes: int,
    report: Callable[[int, int], None] = lambda quality, size: None,
) -> int:
    """Write a film at the best quality whose file is small enough; return its size [bytes].

    Args:
        rate: Frames per second.
        most_bytes: Largest size of the file [bytes].
        report: Called with each quality that was tried and the size [bytes].

    Raises:
        InputError: The film is too large at the lowest quality.
        OSError: The file cannot be written.
    """
    for quality in QUALITIES:
        data = encoded(frames, rate, quality)
        report(quality, len(data))
        if len(data) <= most_bytes:
            path.write_bytes(data)
            return len(data)
    raise InputError(
        f"{len(frames)} frames take {len(data)} bytes at the lowest quality, "
        f"expected at most {most_bytes}"
    )


def encoded(frames: Sequence[Any], rate: float, quality: int) -> bytes:
    """Return frames as an animated WebP that is repeated forever, of a quality of 0 to 100."""
    times = [round(1e3 * k / rate) for k in range(len(frames) + 1)]
    durations = [after - before for before, after in pairwise(times)]
    durations[-1] += round(1e3 * LAST_FRAME)
    stream = io.BytesIO()
    frames[0].save(
        stream,
        "WEBP",
        save_all=True,
        append_images=frames[1:],
        duration=durations,
        loop=0,
        quality=quality,
        method=EFFORT,
    )
    return stream.getvalue()
