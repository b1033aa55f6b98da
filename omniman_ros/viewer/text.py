"""The page's words: the robot's state as HTML, escaped: a node may call itself anything."""

import math
from collections.abc import Iterator
from html import escape

from omniman_ros.viewer.state import Picture

GOOD, WARNING, BAD, QUIET = "#2b8a3e", "#b35c00", "#c92a2a", "#868e96"
_LEVELS = (GOOD, WARNING, BAD)
_SOURCES = {"stop": BAD, "none": QUIET}
LONGEST = 160
"""Characters of one message that are shown."""


def status(picture: Picture, now: float) -> str:
    """HTML of who drives, what holds, where the robot is and what is wrong."""
    return (
        '<div style="padding:0 0.75em 0.4em;font-size:0.8em;line-height:1.5;'
        'overflow-wrap:anywhere">' + "".join(_rows(picture, now)) + "</div>"
    )


def _rows(picture: Picture, now: float) -> Iterator[str]:
    source = picture.active_source
    if source:
        yield _row("driven by", source, _SOURCES.get(source, GOOD))
    else:
        yield _row("driven by", "waiting for platform_controller", WARNING)
    for name, condition in sorted(picture.stops.items()):
        yield _row(name.rpartition("/")[2], condition.text, _LEVELS[condition.level])
    if picture.odom is None:
        yield _row("odom", "not heard yet", WARNING)
    else:
        x, y, theta = picture.odom
        colour = "" if picture.is_fresh("odom", now) else WARNING
        yield _row("odom", f"{x:+.2f} {y:+.2f} m {math.degrees(theta):+.0f}°", colour)
    if picture.odom and picture.truth and picture.is_fresh("truth", now):
        off = math.dist(picture.odom[:2], picture.truth[:2])
        yield _row("off the truth", f"{1e3 * off:.1f} mm", "")
    if picture.is_fresh("progress", now):
        yield _row("path", f"{100.0 * picture.progress:.0f} %", "")
    for name, condition in sorted(picture.complaints.items()):
        if name in picture.stops and condition.text in picture.stops[name].text:
            continue  # said above
        yield _row(name.rpartition("/")[2], condition.text, _LEVELS[condition.level])
    if picture.note:
        yield f'<div style="color:{QUIET}">{_short(picture.note)}</div>'


def _row(name: str, text: str, colour: str) -> str:
    style = f"font-weight:600;color:{colour}" if colour else "font-variant-numeric:tabular-nums"
    return (
        f'<div><span style="color:{QUIET}">{_short(name)}</span> '
        f'<span style="{style}">{_short(text)}</span></div>'
    )


def _short(text: str) -> str:
    return escape(text if len(text) <= LONGEST else text[: LONGEST - 3] + "...")


def legend(names: tuple[str, ...], colours: tuple[str, ...]) -> str:
    """HTML of what the colours of a plot mean."""
    items = " ".join(
        f'<span style="color:{colour};white-space:nowrap">&#9632; {escape(name)}</span>'
        for name, colour in zip(names, colours, strict=True)
    )
    return f'<div style="padding:0 0.9em 0.5em;font-size:0.75em">{items}</div>'
