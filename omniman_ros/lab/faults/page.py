"""The table of faults as Markdown, for the documentation."""

from collections.abc import Iterator

from omniman_ros.lab.faults.rows import Row
from omniman_ros.lab.faults.table import ROWS


def markdown() -> Iterator[str]:
    """Yield the lines of the table, a section for each kind of thing that fails."""
    for subject in dict.fromkeys(row.subject for row in ROWS):
        yield from ("", f"**{subject.value.capitalize()}**", "")
        yield (
            "| row | what happens | the robot | brakes within | what tells it | to drive on "
            "| `omniman fault` |"
        )
        yield "|---|---|---|---|---|---|---|"
        for row in ROWS:
            if row.subject is subject:
                yield f"| {' | '.join(_cells(row))} |"


def _cells(row: Row) -> tuple[str, ...]:
    command = "in the laboratory only" if row.needs_laboratory else f"`{row.short_name}`"
    outcome, going_on = row.outcome.value, row.going_on.value
    return (row.name, row.fault, outcome, reaction(row), row.told, going_on, command)


def reaction(row: Row) -> str:
    """Return within which time what has to brake does so; empty if nothing has to."""
    parts = [name for name, must in (("platform", row.platform), ("arm", row.arm)) if must]
    if not parts:
        return ""
    late = f"{1e3 * row.unnoticed:.0f} ms ({row.timeout}) + " if row.timeout else ""
    return f"{late}{1e3 * row.reaction:.0f} ms: {', '.join(parts)}"
