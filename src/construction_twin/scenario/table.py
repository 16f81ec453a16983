"""The verdict on a run as a table for the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table
from rich.text import Text

from construction_twin.scenario.judge import Judgement


def print_verdict(verdict: Judgement, console: Console) -> None:
    """Print one run's checks."""
    table = Table(title=f"{verdict.scenario}: {verdict.title}", title_justify="left")
    for column in ("check", "expected", "found", ""):
        table.add_column(column, overflow="fold")
    for check in verdict.checks:
        table.add_row(*map(Text, (check.name, check.expected, check.found, "ok" if check.passed else "FAILED")))
    console.print(table)
    console.print(f"{verdict.scenario}: {'passed' if verdict.passed else 'FAILED'}")
