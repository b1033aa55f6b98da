"""The page's words: the robot's state as HTML, escaped: a node may call itself anything."""

import math
from collections.abc import Iterator, Mapping
from html import escape

from omniman_ros.viewer.state import Picture

GOOD, WARNING, BAD, QUIET = "#2b8a3e", "#b35c00", "#c92a2a", "#868e96"
ACCENT = "#1864ab"
_LEVELS = (GOOD, WARNING, BAD)
_SOURCES = {"stop": BAD, "none": QUIET}
_PLANNING = {"driving": GOOD, "arrived": GOOD, "blocked": BAD, "paused": WARNING}
LONGEST = 160
"""Characters of one message that are shown."""
FIRST_STEPS = "Drag the blue goal, or hold a button to drive."


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
        turn = math.degrees(math.remainder(theta, math.tau))
        yield _row("odom", f"{x:+.2f} {y:+.2f} m {turn:+.0f}°", colour)
    if picture.odom and picture.truth and picture.is_fresh("truth", now):
        off = math.dist(picture.odom[:2], picture.truth[:2])
        yield _row("off the truth", f"{1e3 * off:.1f} mm", "")
    if picture.is_fresh("progress", now):
        yield _row("path", f"{100.0 * picture.progress:.0f} %", "")
    if picture.is_fresh("planner", now):
        yield _row("planner", *_planner(picture.planner))
    for name, condition in sorted(picture.complaints.items()):
        if name in picture.stops and condition.text in picture.stops[name].text:
            continue  # said above
        yield _row(name.rpartition("/")[2], condition.text, _LEVELS[condition.level])
    if picture.note:
        yield f'<div style="color:{QUIET}">{_short(picture.note)}</div>'
    elif source == "none" and not len(picture.path.points) and not len(picture.plan.points):
        yield f'<div style="font-weight:600;color:{ACCENT}">{FIRST_STEPS}</div>'


def _planner(said: Mapping[str, str]) -> tuple[str, str]:
    """What the planner does, and the colour of that."""
    state = said.get("state", "")
    words = state
    if state in ("driving", "blocked") and (left := said.get("distance_m")):
        words += f", {left} m to go"
    if why := said.get("why"):
        words += f": {why}"
    return words, _PLANNING.get(state, QUIET)


def _row(name: str, text: str, colour: str) -> str:
    style = f"font-weight:600;color:{colour}" if colour else "font-variant-numeric:tabular-nums"
    return (
        f'<div><span style="color:{QUIET}">{_short(name)}</span> '
        f'<span style="{style}">{_short(text)}</span></div>'
    )


def _short(text: str) -> str:
    return escape(text if len(text) <= LONGEST else text[: LONGEST - 3] + "...")


def hint(text: str) -> str:
    """HTML of a line that says what to do."""
    return (
        f'<div style="padding:0 0.9em 0.5em;font-size:0.75em;color:{QUIET}">{_short(text)}</div>'
    )


def legend(names: tuple[str, ...], colours: tuple[str, ...]) -> str:
    """HTML of what the colours of a plot mean."""
    items = " ".join(
        f'<span style="color:{colour};white-space:nowrap">&#9632; {escape(name)}</span>'
        for name, colour in zip(names, colours, strict=True)
    )
    return f'<div style="padding:0 0.9em 0.5em;font-size:0.75em">{items}</div>'
