"""The HTML page of `omniman reproduce all`, which compares measured with published results.

The page is self-contained: pictures are embedded, and it needs neither the network nor scripts.
"""

import base64
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from omniman_ros.lab.reproduce.experiments import EXPERIMENTS
from omniman_ros.lab.reproduce.findings import Verdict

TEMPLATE = "report.html.j2"
"""File name of the page's Jinja template, which is in the folder of this module."""
PHRASES = {
    Verdict.AGREES: "agree",
    Verdict.PARTLY: "in part",
    Verdict.DIFFERS: "differ",
    Verdict.UNLIKE: "not like for like",
    Verdict.SHOWN: "without a published number",
    Verdict.MISSING: "not measured",
}
"""Text that follows the number of comparisons with each verdict."""
MIN_MINUTES = 120.0
"""Shortest duration that is shown in minutes instead of seconds [s]."""


def page(result: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Render the page.

    Args:
        result: Summary of all experiments, as published in JSON.
        pictures: Contents of the PNG files, by the name of the experiment.

    Returns:
        The HTML, in which all text from the results is escaped.
    """
    environment = Environment(
        loader=PackageLoader("omniman_ros.lab.reproduce", "."),
        autoescape=True,
        undefined=StrictUndefined,
        keep_trailing_newline=True,
    )
    environment.filters |= {"duration": duration, "minute": minute, "sentence": sentence}
    machine, experiments = result["machine"], result["experiments"]
    counts = [
        f"{count} {PHRASES[Verdict(name)]}" for name, count in result["verdicts"].items() if count
    ]
    return environment.get_template(TEMPLATE).render(
        date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        took=duration(sum(row["took_s"] or 0.0 for row in experiments)),
        versions=", ".join(f"{name} {value}" for name, value in result["versions"].items()),
        machine=f"{machine['processor']}, {machine['cores']} cores, {machine['system']}",
        counts=" · ".join(counts),
        warnings=warnings(result),
        comparisons=result["comparisons"],
        world=result["world"],
        experiments=experiments,
        also=result["also"],
        own=result["own"],
        figures=[figure(row["name"], pictures) for row in experiments],
    )


def figure(name: str, pictures: Mapping[str, bytes]) -> dict[str, str]:
    """Return the name, caption and image of an experiment for the template.

    The image is a PNG file in base64, or empty if the experiment has no picture.
    """
    image = base64.b64encode(pictures.get(name, b"")).decode("ascii")
    return {"name": name, "caption": EXPERIMENTS[name].caption, "image": image}


def warnings(result: Mapping[str, Any]) -> str:
    """Return the warnings for the top of the page: failures, quick runs and reused results.

    The text is empty if there is nothing to warn of.
    """
    experiments = result["experiments"]
    failed = [row["name"] for row in experiments if row["verdict"] in ("failed", "no result")]
    quick = [row["name"] for row in experiments if row["effort"] == "quick"]
    reused = [row["name"] for row in experiments if row["reused"]]
    lines = []
    if failed:
        lines.append(f"Failed or without a result: {', '.join(failed)}.")
    if quick:
        lines.append(f"Quick, a few drives only: {', '.join(quick)}.")
    if reused:
        lines.append(f"From earlier runs, see their dates: {', '.join(reused)}.")
    return " ".join(lines)


def duration(seconds: float | None) -> str:
    """Format a duration [s] in seconds or minutes; return an empty text for None."""
    if seconds is None:
        return ""
    return f"{seconds:.0f} s" if seconds < MIN_MINUTES else f"{seconds / 60:.0f} min"


def minute(time: str) -> str:
    """Format a time in ISO 8601 with a resolution of one minute."""
    return time[:16].replace("T", " ")


def sentence(text: str) -> str:
    """Capitalise a phrase and end it with a full stop; an empty text stays empty."""
    return text[:1].upper() + text[1:] + "." if text else ""
