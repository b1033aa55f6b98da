"""The page of `omniman reproduce all`: measured against published, in one HTML file.

The page contains everything, pictures included, and needs neither network nor scripts.
"""

import base64
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from omniman_ros.lab.reproduce.experiments import EXPERIMENTS
from omniman_ros.lab.reproduce.findings import Verdict

TEMPLATE = "report.html.j2"
"""Template of the page, which lies beside this module."""
PHRASES = {
    Verdict.AGREES: "agree",
    Verdict.PARTLY: "in part",
    Verdict.DIFFERS: "differ",
    Verdict.SHOWN: "with nothing published to judge by",
    Verdict.MISSING: "not measured",
}
"""Text after the number of comparisons with each verdict."""
LONG = 120.0
"""Duration from which minutes are shown instead of seconds [s]."""


def page(result: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Render the page.

    Args:
        result: The result of all experiments, as it is published as JSON.
        pictures: PNG files by the name of the experiment.

    Returns:
        The HTML; all text of the result is escaped.
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
        experiments=experiments,
        also=result["also"],
        own=result["own"],
        figures=[figure(row["name"], pictures) for row in experiments],
    )


def figure(name: str, pictures: Mapping[str, bytes]) -> dict[str, str]:
    """Return name, caption and image (base64, empty without a picture) of an experiment."""
    image = base64.b64encode(pictures.get(name, b"")).decode("ascii")
    return {"name": name, "caption": EXPERIMENTS[name].caption, "image": image}


def warnings(result: Mapping[str, Any]) -> str:
    """Return what a reader must know before anything else; empty if there is nothing."""
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
    """Format a duration [s] in seconds or minutes; empty if it is None."""
    if seconds is None:
        return ""
    return f"{seconds:.0f} s" if seconds < LONG else f"{seconds / 60:.0f} min"


def minute(time: str) -> str:
    """Format a time in ISO 8601 up to the minute."""
    return time[:16].replace("T", " ")


def sentence(text: str) -> str:
    """Capitalise a phrase and end it with a full stop; empty stays empty."""
    return text[:1].upper() + text[1:] + "." if text else ""
