"""The summary of `omniman reproduce all`: results become findings, and findings a page."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omniman_ros.lab.reproduce.findings import Finding, Verdict
from omniman_ros.lab.reproduce.own import FIGURES
from omniman_ros.lab.reproduce.page import page
from omniman_ros.lab.reproduce.provenance import machine, versions
from omniman_ros.lab.reproduce.published import CLAIMS, Claim

PAGE_NAME = "report.html"
OPTIONAL = ("demo", "identify_friction", "bench_control", "bench_mpc", "bench_can", "bench_arm")
"""Names of further results, which are used where they are in the folder."""


@dataclass(frozen=True)
class ExperimentResult:
    """The result of one experiment.

    Attributes:
        name: Name of the experiment.
        code: Exit code; None if it was not run because its result was reused.
        result: Its JSON; None if it wrote none.
    """

    name: str
    code: int | None
    result: dict[str, Any] | None

    @property
    def passed(self) -> bool:
        """Whether the experiment ran to its end and passed by its own exit code."""
        return self.result is not None and not self.code and self.result.get("passed") is not False

    @property
    def verdict(self) -> str:
        """The outcome in a word or two."""
        if self.result is None:
            return "no result"
        if not self.passed:
            return "failed"
        return "aim missed" if self.result.get("aim", {}).get("met") is False else "passed"


def load(path: Path) -> dict[str, Any] | None:
    """Load a result; return None if there is none, or none that can be read."""
    try:
        tree = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return tree if isinstance(tree, dict) else None


def summarize(
    done: Sequence[ExperimentResult], folder: Path, took: float
) -> tuple[dict[str, Any], Path]:
    """Compare the results with what is published, and write the page.

    Args:
        done: Results of the experiments.
        folder: Folder of the page, in which further results may be.
        took: Duration of all experiments [s].

    Returns:
        The summary, to be published as JSON, and the path of the page.

    Raises:
        OSError: The page cannot be written.
    """
    new = {
        experiment.name: experiment.result for experiment in done if experiment.result is not None
    }
    also = {name: read for name in OPTIONAL if (read := load(folder / f"{name}.json")) is not None}
    results = {**also, **new}
    rows = [(claim, claim.find(results)) for claim in CLAIMS]
    own = [(claim, claim.find(results)) for claim in FIGURES]
    own = [(claim, finding) for claim, finding in own if finding.verdict is not Verdict.MISSING]
    result: dict[str, Any] = {
        "passed": all(experiment.passed for experiment in done),
        "experiments": [experiment_row(experiment) for experiment in done],
        "also": {name: made(read) for name, read in also.items()},
        "verdicts": dict(counted(rows)),
        "comparisons": [claim_row(claim, finding) for claim, finding in rows],
        "own": [claim_row(claim, finding) for claim, finding in own],
        "versions": versions(),
        "machine": machine(),
        "took_s": took,
        "report": str(folder / PAGE_NAME),
    }
    path = folder / PAGE_NAME
    path.write_text(page(result, pictures(done, folder)), encoding="utf-8")
    return result, path


def claim_row(claim: Claim, finding: Finding) -> dict[str, Any]:
    """Return a comparison for the JSON."""
    return {
        "quantity": claim.quantity,
        "source": claim.source,
        "published": claim.published,
        "rule": claim.rule,
        "note": claim.note,
        "from": list(claim.needs),
        "measured": finding.text,
        "values": dict(finding.values),
        "verdict": finding.verdict.value,
    }


def experiment_row(experiment: ExperimentResult) -> dict[str, Any]:
    """Return an experiment for the JSON."""
    result = experiment.result or {}
    effort = [name for name in ("quick", "full") if result.get(name)]
    usual = "default" if "quick" in result else None  # results of scenes only have a number
    drives = len(result.get("drives", ())) or sum(
        len(row["epsilon_max_samples"]) for row in result.get("table", ())
    )
    return {
        "name": experiment.name,
        "verdict": experiment.verdict,
        "code": experiment.code,
        "reused": experiment.code is None,
        "effort": effort[0] if effort else usual,
        "drives": drives,
        "robot": result.get("robot"),
        "seed": result.get("seed"),
        "took_s": result.get("took_s"),
        "made": made(result),
    }


def made(result: Mapping[str, Any]) -> str:
    """Return the time at which a result was made, in ISO 8601; empty if it is not known."""
    return str(result.get("about", {}).get("time", ""))


def counted(rows: Iterable[tuple[Claim, Finding]]) -> list[tuple[str, int]]:
    """Return the number of comparisons with each verdict, in the order of the verdicts."""
    counts = Counter(finding.verdict for _, finding in rows)
    return [(verdict.value, counts[verdict]) for verdict in Verdict]


def pictures(done: Sequence[ExperimentResult], folder: Path) -> dict[str, bytes]:
    """Read the PNG files that the results name, by experiment."""
    images = {}
    for experiment in done:
        picture = (experiment.result or {}).get("picture")
        if picture:
            try:
                images[experiment.name] = (folder / Path(picture).name).read_bytes()
            except OSError:
                continue
    return images
