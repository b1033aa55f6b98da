"""The summary of `omniman reproduce all`: compares the results with the papers' claims.

The comparisons are returned for publication as JSON, and written as an HTML page.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omniman_ros.lab.reproduce.experiments import EXPERIMENTS, result_name
from omniman_ros.lab.reproduce.findings import Finding, Verdict
from omniman_ros.lab.reproduce.own import OWN_RESULTS
from omniman_ros.lab.reproduce.page import page
from omniman_ros.lab.reproduce.provenance import machine, versions
from omniman_ros.lab.reproduce.published import CLAIMS, Claim
from omniman_ros.simulation.world.parameters import ROLLERS

PAGE_NAME = "report.html"
"""File name of the page."""
OPTIONAL_RESULTS = (
    "demo",
    "identify_friction",
    "bench_control",
    "bench_mpc",
    "bench_can",
    "bench_arm",
)
"""Names of the results of other commands, which are included if they are in the folder."""


@dataclass(frozen=True)
class ExperimentResult:
    """The result of one experiment.

    Attributes:
        name: Name of the experiment.
        code: Exit code; None if the experiment did not run because its result was reused.
        result: JSON of the result; None if the experiment wrote none.
    """

    name: str
    code: int | None
    result: dict[str, Any] | None

    @property
    def passed(self) -> bool:
        """Whether there is a result, and neither the exit code nor the result is a failure."""
        return self.result is not None and not self.code and self.result.get("passed") is not False

    @property
    def verdict(self) -> str:
        """Outcome: "no result", "failed", "aim missed" or "passed"."""
        if self.result is None:
            return "no result"
        if not self.passed:
            return "failed"
        return "aim missed" if self.result.get("aim", {}).get("met") is False else "passed"


def load(path: Path) -> dict[str, Any] | None:
    """Load a result; return None if the file does not exist or is not a JSON object."""
    try:
        tree = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    return tree if isinstance(tree, dict) else None


def summarize(
    finished: Sequence[ExperimentResult], folder: Path, duration: float, wheels: str = ROLLERS
) -> tuple[dict[str, Any], Path]:
    """Compare the results with the published claims, and write the page.

    Args:
        finished: Results of the experiments.
        folder: Folder of the page; `OPTIONAL_RESULTS` are read from it, and results from the
            physics world.
        duration: Duration of all experiments together [s].
        wheels: Kind of wheels in the physics world.

    Returns:
        The summary for publication as JSON, and the path of the page.

    Raises:
        OSError: The page cannot be written.
    """
    reproduced = {
        experiment.name: experiment.result
        for experiment in finished
        if experiment.result is not None
    }
    optional = {
        name: loaded
        for name in OPTIONAL_RESULTS
        if (loaded := load(folder / f"{name}.json")) is not None
    }
    results = {**optional, **reproduced}
    world = {
        experiment.name: loaded
        for experiment in EXPERIMENTS.values()
        if experiment.in_world
        and (loaded := load(folder / f"{result_name(experiment.name, wheels)}.json")) is not None
    }
    rows = [(claim, claim.find(results)) for claim in CLAIMS]
    own = [(claim, claim.find(results)) for claim in OWN_RESULTS]
    own = [
        (claim, finding)
        for claim, finding in own
        if {finding.verdict, claim.find(world).verdict} != {Verdict.MISSING}
    ]
    result: dict[str, Any] = {
        "passed": all(experiment.passed for experiment in finished),
        "experiments": [experiment_row(experiment) for experiment in finished],
        "also": {
            name: creation_time(loaded)
            for name, loaded in (
                *optional.items(),
                *((f"{name} on {wheels}", loaded) for name, loaded in world.items()),
            )
        },
        "world": wheels if world else None,
        "verdicts": dict(verdict_counts(rows)),
        "comparisons": [claim_row(claim, finding, claim.find(world)) for claim, finding in rows],
        "own": [claim_row(claim, finding, claim.find(world)) for claim, finding in own],
        "versions": versions(),
        "machine": machine(),
        "took_s": duration,
        "report": str(folder / PAGE_NAME),
    }
    path = folder / PAGE_NAME
    path.write_text(page(result, pictures(finished, folder)), encoding="utf-8")
    return result, path


def claim_row(claim: Claim, finding: Finding, in_world: Finding) -> dict[str, Any]:
    """Return the comparison of a claim with its finding, for the JSON.

    Args:
        claim: The claim.
        finding: Its finding on the plant.
        in_world: Its finding in the physics world, which is not judged.
    """
    return {
        "quantity": claim.quantity,
        "source": claim.source,
        "published": claim.published,
        "rule": claim.rule,
        "note": claim.note,
        "unlike": claim.unlike,
        "from": list(claim.needs),
        "measured": finding.text,
        "in_world": "" if in_world.verdict is Verdict.MISSING else in_world.text,
        "values": dict(finding.values),
        "verdict": finding.verdict.value,
    }


def experiment_row(experiment: ExperimentResult) -> dict[str, Any]:
    """Return the row of an experiment for the JSON: its outcome, size and origin."""
    result = experiment.result or {}
    effort = [name for name in ("quick", "full") if result.get(name)]
    # The result of `scenes` has no "quick": its size is the number of drives alone.
    default = "default" if "quick" in result else None
    drives = len(result.get("drives", ())) or sum(
        len(row["epsilon_max_samples"]) for row in result.get("table", ())
    )
    return {
        "name": experiment.name,
        "verdict": experiment.verdict,
        "code": experiment.code,
        "reused": experiment.code is None,
        "effort": effort[0] if effort else default,
        "drives": drives,
        "robot": result.get("robot"),
        "seed": result.get("seed"),
        "took_s": result.get("took_s"),
        "made": creation_time(result),
    }


def creation_time(result: Mapping[str, Any]) -> str:
    """Return the time at which a result was created, in ISO 8601; empty if it is unknown."""
    return str(result.get("about", {}).get("time", ""))


def verdict_counts(rows: Iterable[tuple[Claim, Finding]]) -> list[tuple[str, int]]:
    """Return each verdict with the number of its comparisons, in the order of :class:`Verdict`."""
    counts = Counter(finding.verdict for _, finding in rows)
    return [(verdict.value, counts[verdict]) for verdict in Verdict]


def pictures(finished: Sequence[ExperimentResult], folder: Path) -> dict[str, bytes]:
    """Read the PNG files of the experiments from a folder, by the name of the experiment.

    Experiments whose picture is missing or cannot be read are left out.
    """
    images = {}
    for experiment in finished:
        picture = (experiment.result or {}).get("picture")
        if picture:
            try:
                images[experiment.name] = (folder / Path(picture).name).read_bytes()
            except OSError:
                continue
    return images
