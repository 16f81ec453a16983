"""Verdicts as tables: of one run for the terminal, of many for docs/scenarios.md."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from construction_twin.core.errors import ScenarioError
from construction_twin.core.sentences import Sentence
from construction_twin.scenario.judge import Judgement

#: Lines between which a document holds the table.
BEGIN, END = "<!-- scenarios: begin -->", "<!-- scenarios: end -->"
_HEAD = (
    "scenario",
    "what the system did",
    "detection [s]",
    "samples over the threshold",
    "worst error [deg]",
    "worst velocity",
    "worst acceleration",
    "missed replies",
    "arm, worst acceleration",
    "stop distance [deg]",
    "passed",
)


def print_verdict(verdict: Judgement, console: Console) -> None:
    """Print one run's checks."""
    table = Table(title=f"{verdict.scenario}: {verdict.title}", title_justify="left")
    for column in ("check", "expected", "found", ""):
        table.add_column(column, overflow="fold")
    for check in verdict.checks:
        table.add_row(*map(Text, (check.name, check.expected, check.found, "ok" if check.passed else "FAILED")))
    console.print(table)
    console.print(f"{verdict.scenario}: {'passed' if verdict.passed else 'FAILED'}")


def read_verdicts(folder: Path) -> dict[str, list[dict]]:
    """Return every verdict below a folder by scenario, sorted by name.

    Raises:
        ScenarioError: If there is none.
    """
    found = defaultdict(list)
    for path in sorted(folder.rglob("verdict.json")):
        verdict = json.loads(path.read_text())
        found[verdict["scenario"]].append(verdict)
    if not found:
        raise ScenarioError(Sentence("view.scenario.no_verdict", folder=str(folder)))
    return dict(sorted(found.items()))


def markdown_table(verdicts: dict[str, list[dict]]) -> str:
    """Return the table over all runs: times as smallest to largest, errors and fractions of the limits as the largest."""
    lines = ["| " + " | ".join(_HEAD) + " |", "|" + "---|" * len(_HEAD)]
    lines += ["| " + " | ".join(_row(name, runs)) + " |" for name, runs in verdicts.items()]
    return "\n".join(lines) + "\n"


def put_into(text: str, table: str, where: str) -> str:
    """Return a document with the table between its two marks.

    Raises:
        ScenarioError: If the marks are not there.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ScenarioError(Sentence("view.scenario.no_lines", where=where, begin=repr(BEGIN), end=repr(END)))
    return f"{before}{BEGIN}\n{table}{END}{after}"


def _row(name: str, runs: list[dict]) -> Iterable[str]:
    measured = [run["measured"] for run in runs]
    did = sorted({m["did"] for m in measured})
    worst = max(measured, key=lambda m: m["worst_error_deg"])
    yield f"`{name}`"
    yield " / ".join(did)
    yield _span([m["detection_s"] for m in measured], 3)
    yield _span([m["detection_samples"] for m in measured], 0)
    yield f"{worst['worst_error_deg']:.3f} ({worst['worst_joint']})"
    for fraction in ("velocity_fraction", "acceleration_fraction"):
        yield f"{max(m[fraction] for m in measured):.3f}"
    yield _span([m["missed_replies"] for m in measured], 0)
    # None: no joint is sound
    fractions = [m["arm_acceleration_fraction"] for m in measured if m["arm_acceleration_fraction"] is not None]
    yield f"{max(fractions):.3f}" if fractions else "–"
    yield _span([m["stop_distance_deg"] for m in measured], 3)
    yield f"{sum(run['passed'] for run in runs)} of {len(runs)}"


def _span(values: list[float | None], digits: int) -> str:
    known = [value for value in values if value is not None]
    if not known:
        return "–"
    low, high = f"{min(known):.{digits}f}", f"{max(known):.{digits}f}"
    return low if low == high else f"{low} to {high}"
