"""The page of `omniman reproduce all`: measured against published, in one HTML file.

It holds everything, pictures too, and needs neither network nor script.
"""

import base64
import importlib.metadata
import json
import platform
import subprocess
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import Any

import omniman_ros
from omniman_ros.cli.reproduce_findings import Finding, Verdict
from omniman_ros.cli.reproduce_own import FIGURES
from omniman_ros.cli.reproduce_page import PAGE
from omniman_ros.cli.reproduce_published import CLAIMS, Claim
from omniman_ros.cli.results import about

PAGE_NAME = "report.html"
OPTIONAL = ("demo", "identify_friction", "bench_control", "bench_mpc", "bench_can", "bench_arm")
"""Results that are told of where they are in the folder."""
LIBRARIES = ("omniman_ros", "numpy", "casadi")
CAPTIONS = {
    "coupling": "Coupling error along the path of CCTA 2017, Fig. 7, and what the gain does",
    "tool_path": "Tool on its path, platform and arm in step: with the arm's correction, without",
    "free": "Free movement, MPC 2021, 4.1",
    "corridor": "Narrow corridor, MPC 2021, 4.2",
    "moving": "Moving obstacles, MPC 2021, 4.3 (the film is beside this page)",
    "workshop": "A dead end and three doors, with a map",
    "scenes": "Random scenes: those that failed, then those that came closest to something",
}
WORDS = {
    Verdict.AGREES: "agree",
    Verdict.PARTLY: "in part",
    Verdict.DIFFERS: "differ",
    Verdict.SHOWN: "with nothing published to judge by",
    Verdict.MISSING: "not measured",
}


@dataclass(frozen=True)
class Experiment:
    """What became of one experiment.

    Attributes:
        name: Of the experiment.
        code: Exit code; None if it was not run, as its result was there.
        result: Its JSON; None if it wrote none.
    """

    name: str
    code: int | None
    result: dict[str, Any] | None

    @property
    def passed(self) -> bool:
        """Whether it ran to its end and did what it should, as its own exit code has it."""
        return self.result is not None and not self.code and self.result.get("passed") is not False

    @property
    def verdict(self) -> str:
        """The same in a word or two."""
        if self.result is None:
            return "no result"
        if not self.passed:
            return "failed"
        return "aim missed" if self.result.get("aim", {}).get("met") is False else "passed"


def load(path: Path) -> dict[str, Any] | None:
    """A result; None if there is none, or none that can be read."""
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def summed_up(
    done: Sequence[Experiment], folder: Path, took: float
) -> tuple[dict[str, Any], Path]:
    """Compare, write the page, and give what is published as JSON and where the page is.

    Args:
        done: What became of the experiments.
        folder: Where the page goes and where further results may be.
        took: Time of all [s].

    Raises:
        OSError: The page cannot be written.
    """
    found = {one.name: one.result for one in done if one.result is not None}
    also = {name: read for name in OPTIONAL if (read := load(folder / f"{name}.json")) is not None}
    results = {**also, **found}
    rows = [(claim, claim.find(results)) for claim in CLAIMS]
    own = [(claim, claim.find(results)) for claim in FIGURES]
    own = [(claim, finding) for claim, finding in own if finding.verdict is not Verdict.MISSING]
    result: dict[str, Any] = {
        "passed": all(one.passed for one in done),
        "experiments": [experiment_row(one) for one in done],
        "also": {name: made(read) for name, read in also.items()},
        "verdicts": dict(counted(rows)),
        "comparisons": [claim_row(claim, finding) for claim, finding in rows],
        "own": [claim_row(claim, finding) for claim, finding in own],
        "versions": versions(), "machine": machine(), "took_s": took,
        "report": str(folder / PAGE_NAME),
    }  # fmt: skip
    path = folder / PAGE_NAME
    path.write_text(page(result, pictures(done, folder)), encoding="utf-8")
    return result, path


def claim_row(claim: Claim, finding: Finding) -> dict[str, Any]:
    """A comparison as JSON."""
    return {
        "quantity": claim.quantity, "source": claim.source, "published": claim.published,
        "rule": claim.rule, "note": claim.note, "from": list(claim.needs),
        "measured": finding.text, "values": dict(finding.values),
        "verdict": finding.verdict.value,
    }  # fmt: skip


def experiment_row(one: Experiment) -> dict[str, Any]:
    """An experiment as JSON."""
    result = one.result or {}
    effort = [name for name in ("quick", "full") if result.get(name)]
    usual = "default" if "quick" in result else None  # the scenes tell their number alone
    drives = len(result.get("drives", ())) or sum(
        len(row["epsilon_max_samples"]) for row in result.get("table", ())
    )
    return {
        "name": one.name, "verdict": one.verdict, "code": one.code, "reused": one.code is None,
        "effort": effort[0] if effort else usual, "drives": drives,
        "robot": result.get("robot"), "seed": result.get("seed"),
        "took_s": result.get("took_s"), "made": made(result),
    }  # fmt: skip


def made(result: Mapping[str, Any]) -> str:
    """When a result was made; empty if it does not say."""
    return str(result.get("about", {}).get("time", ""))


def counted(rows: Iterable[tuple[Claim, Finding]]) -> list[tuple[str, int]]:
    """How many comparisons came to which verdict, in the order of the verdicts."""
    counts = Counter(finding.verdict for _, finding in rows)
    return [(verdict.value, counts[verdict]) for verdict in Verdict]


# ---- where it was made --------------------------------------------------------------------------


def versions() -> dict[str, str]:
    """Of the package, its commit where it lies in a git working tree, Python and libraries."""
    found = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    if said := commit(Path(omniman_ros.__file__)):
        found["commit"] = said
    return found


def commit(file: Path) -> str:
    """Commit of the working tree that tracks a file, `+` where it was changed since; or empty."""

    def git(*arguments: str) -> str | None:
        try:
            ended = subprocess.run(
                ["git", "-C", str(file.parent), *arguments],
                capture_output=True, text=True, timeout=10.0, check=False,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired):
            return None
        return ended.stdout.strip() if ended.returncode == 0 else None

    if git("ls-files", "--error-unmatch", file.name) is None:
        return ""
    head, changed = git("rev-parse", "--short=12", "HEAD"), git("status", "--porcelain", "-uno")
    return f"{head}{'+' if changed else ''}" if head else ""


def machine() -> dict[str, Any]:
    """Processor, number of cores and system; nothing that names the machine."""
    model = platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    try:
        system = platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        system = platform.system()
    return {"processor": model, "cores": about()["cores"], "system": system}


# ---- the page -----------------------------------------------------------------------------------


def pictures(done: Sequence[Experiment], folder: Path) -> dict[str, bytes]:
    """The PNG files that the results speak of, by experiment."""
    found = {}
    for one in done:
        named = (one.result or {}).get("picture")
        if named:
            try:
                found[one.name] = (folder / Path(named).name).read_bytes()
            except OSError:
                continue
    return found


def page(result: Mapping[str, Any], drawn: Mapping[str, bytes]) -> str:
    """The page, of what is published as JSON and the pictures."""
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    where = result["machine"]
    said = [f"{n} {WORDS[Verdict(name)]}" for name, n in result["verdicts"].items() if n]
    return PAGE.substitute(
        date=now,
        took=duration(sum(row["took_s"] or 0.0 for row in result["experiments"])),
        versions=escape(listed(result["versions"])),
        machine=escape(f"{where['processor']}, {where['cores']} cores, {where['system']}"),
        counts=escape(" · ".join(said)),
        warning=warning(result["experiments"]),
        comparisons="\n".join(comparison_html(row) for row in result["comparisons"]),
        experiments="\n".join(experiment_html(row) for row in result["experiments"]),
        also=also_html(result["also"]),
        own=own_html(result["own"]),
        figures="\n".join(figure_html(row["name"], drawn) for row in result["experiments"]),
    )


def listed(found: Mapping[str, str]) -> str:
    """Names and versions in a line."""
    return ", ".join(f"{name} {value}" for name, value in found.items())


def duration(seconds: float | None) -> str:
    """A time for people."""
    if seconds is None:
        return ""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def warning(experiments: Sequence[Mapping[str, Any]]) -> str:
    """What must be known before anything else is read."""
    lines = []
    failed = [row["name"] for row in experiments if row["verdict"] in ("failed", "no result")]
    quick = [row["name"] for row in experiments if row["effort"] == "quick"]
    reused = [row["name"] for row in experiments if row["reused"]]
    if failed:
        lines.append(f"Failed or without a result: {', '.join(failed)}.")
    if quick:
        lines.append(f"Quick, a few drives only: {', '.join(quick)}.")
    if reused:
        lines.append(f"From earlier runs, see their dates: {', '.join(reused)}.")
    return f'<p class="warning">{escape(" ".join(lines))}</p>' if lines else ""


def _small(text: str) -> str:
    return f"<small>{escape(text)}</small>" if text else ""


def comparison_html(row: Mapping[str, Any]) -> str:
    """A row of the comparison."""
    rule = f"Agrees if: {row['rule']}." if row["rule"] else ""
    kind = row["verdict"].replace(" ", "-")
    note = row["note"][:1].upper() + row["note"][1:] + "." if row["note"] else ""
    return (
        f'<tr><th scope="row">{escape(row["quantity"])}{_small(row["source"])}</th>'
        f"<td>{escape(row['published'])}{_small(rule)}</td>"
        f"<td>{escape(row['measured'])}{_small(note)}</td>"
        f'<td><span class="verdict {kind}">{escape(row["verdict"])}</span></td></tr>'
    )


def experiment_html(row: Mapping[str, Any]) -> str:
    """A row of the experiments."""
    cells = (
        row["verdict"], row["effort"] or "", row["drives"] or "", row["robot"] or "",
        "" if row["seed"] is None else row["seed"], duration(row["took_s"]),
        row["made"][:16].replace("T", " "),
    )  # fmt: skip
    rest = "".join(f"<td>{escape(str(cell))}</td>" for cell in cells)
    return f'<tr><th scope="row">{escape(row["name"])}</th>{rest}</tr>'


def also_html(also: Mapping[str, str]) -> str:
    """Further results that were found in the folder."""
    if not also:
        return ""
    listed = ", ".join(f"{name} ({when[:16].replace('T', ' ')})" for name, when in also.items())
    return f"<p>Also read, as they were found: {escape(listed)}.</p>"


def own_html(own: Sequence[Mapping[str, Any]]) -> str:
    """What only this package has."""
    if not own:
        return ""
    rows = "\n".join(
        f'<tr><th scope="row">{escape(row["quantity"])}</th>'
        f"<td>{escape(row['measured'])}</td></tr>"
        for row in own
    )
    return (
        "<section>\n<h2>This package, nothing published</h2>\n"
        f'<table class="own"><tbody>{rows}</tbody></table>\n</section>'
    )


def figure_html(name: str, drawn: Mapping[str, bytes]) -> str:
    """A picture with its caption; a line of text where there is none."""
    caption = f"<figcaption><b>{escape(name)}</b> {escape(CAPTIONS[name])}</figcaption>"
    if name not in drawn:
        return f"<figure>{caption}<p>no picture</p></figure>"
    data = base64.b64encode(drawn[name]).decode("ascii")
    alt = escape(CAPTIONS[name], quote=True)
    return f'<figure><img src="data:image/png;base64,{data}" alt="{alt}">{caption}</figure>'
