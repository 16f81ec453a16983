"""Writes a recording's report: `report.html`, `summary.json`, `table1.csv` and the figures.

Importing matplotlib takes a second.
"""

from __future__ import annotations

import base64
import dataclasses
import importlib.metadata
import json
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation import figures
from construction_twin.evaluation.recording import Recording
from construction_twin.evaluation.summary import evaluate, summarise
from construction_twin.evaluation.tables import (
    ALIGNMENTS,
    NOTE,
    TableRow,
    facts,
    remarks,
    table_csv,
    table_rows,
    unavailable,
)
from construction_twin.robot.description import RobotModel

#: Most rows of the table of state changes; a bag of an unstable link may hold thousands.
MOST_CHANGES = 500
#: Words of states that are faults.
FAULTS = {
    "HOLDING", "STALE", "STOPPED", "FAULT", "REFUSING", "REPLANNING", "HELD",
    "DISCONNECTED", "GATEWAY_OFFLINE", "NO_CONTROLLER", "MISMATCH", "NEEDS_RESET",
}  # fmt: skip
_HEADINGS = {
    "figure8.png": "Tool path (the paper's Figure 8)",
    "figure9.png": "Joints (the paper's Figure 9)",
    "timing.png": "Timing",
}
_CIRCUMSTANCES = {
    "skipped_samples": "Samples left out, per comparison",
    "mock": "Settings of the mock controller",
    "environment": "Machine and versions",
}
_COLUMNS = ("joint", "avg", "max", "paper avg, rad", "paper max, rad", "avg/paper", "max/paper")
_STYLE = """
:root { color-scheme: light dark; --back: #fff; --ink: #1b1d22; }
@media (prefers-color-scheme: dark) { :root { --back: #16181d; --ink: #d9dce3; } img { filter: brightness(.85); } }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem;
  background: var(--back); color: var(--ink); }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid #8886; }
table { border-collapse: collapse; display: block; overflow-x: auto; }
th, td { padding: .2rem .7rem; text-align: right; border-bottom: 1px solid #8883; font-variant-numeric: tabular-nums; }
th:first-child, td:first-child, .text th, .text td { text-align: left; }
caption { display: block; text-align: left; padding: .6rem 0 .2rem; font-weight: 600; max-width: calc(100vw - 2rem); }
img { max-width: 100%; height: auto; background: white; }
td { white-space: nowrap; } .text td:last-child, .values td { white-space: normal; overflow-wrap: anywhere; }
.values td { text-align: left; vertical-align: top; }
.fault td { background: #d9541e33; } .note { opacity: .75; } .warning { border-left: 4px solid #d9541e; padding-left: .7rem; }
@media (max-width: 40rem) {
  body { margin: .8rem auto; padding: 0 .6rem; } h1 { font-size: 1.25rem; } th, td { padding: .2rem .35rem; font-size: .8rem; }
}
"""


def page(summary: Mapping, recording: Recording, drawings: Mapping[str, bytes]) -> str:
    """Return the page.

    Args:
        recording: For its plans and state changes.

    Returns:
        ASCII except for text from the recording.
    """
    title = f"Twin and physical arm: {summary['robot']}"
    sections = [
        f"<h1>{escape(title)}</h1>",
        _facts(summary),
        *_error_tables(summary),
        *_figures(drawings),
        _timing(summary),
        _plans(recording),
        _changes(recording),
        _details(summary),
    ]
    body = "\n".join(section for section in sections if section)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )


def _facts(summary: Mapping) -> str:
    table = _table(("", "here", "paper"), facts(summary), "", "text")
    return "\n".join([table, *(f'<p class="warning">{escape(remark)}</p>' for remark in remarks(summary))])


def _error_tables(summary: Mapping) -> Iterable[str]:
    yield "<h2>Errors per joint</h2>"
    rows = list(table_rows(summary["tables"]))
    for alignment, meaning in ALIGNMENTS.items():
        if summary["tables"].get(alignment) is None:
            yield f"<p>{escape(unavailable(alignment))}.</p>"
            continue
        cells = [_error_row(row) for row in rows if row.alignment == alignment]
        yield _table(_COLUMNS, cells, f"{alignment}: {meaning}")
    yield f'<p class="note">{escape(NOTE)}.</p>'


def _error_row(row: TableRow) -> list[str]:
    unit = "rad" if row.avg_m is None else "m"
    errors = (row.avg_rad, row.max_rad) if row.avg_m is None else (row.avg_m, row.max_m)
    figures = [f"{_number(value, '.4e')} {unit}" for value in errors]
    paper = [_number(value, ".4e") for value in (row.paper_avg_rad, row.paper_max_rad)]
    return [row.joint, *figures, *paper, _number(row.avg_ratio, ".3g"), _number(row.max_ratio, ".3g")]


def _figures(drawings: Mapping[str, bytes]) -> Iterable[str]:
    for name in sorted(drawings):
        heading = escape(_HEADINGS.get(name, name))
        data = base64.b64encode(drawings[name]).decode("ascii")
        yield f'<h2>{heading}</h2>\n<img alt="{heading}" src="data:image/png;base64,{data}">'


def _timing(summary: Mapping) -> str:
    names = ("p50", "p99", "p99_9", "max")
    rows = [
        [label, *(_number(summary[key].get(name), form) for name in names)]
        for label, key, form in (
            ("round trip, ms", "round_trip_ms", ".3f"),
            ("RSI reply time, us", "reply_us", ".0f"),
        )
    ]
    table = _table(("", "p50", "p99", "p99.9", "max"), rows, "Latency")
    rates = [[name, _number(rate, ".3f")] for name, rate in summary["rate_hz"].items()]
    counts = [
        [key.replace("_", " "), _number(summary[key], "d")]
        for key in ("commands_sent", "commands_lost", "late_replies")
    ]
    return f"{table}\n{_table(('stream', 'Hz'), rates, 'Rates')}\n{_table(('count', ''), counts, 'Sent, lost, late')}"


def _plans(recording: Recording) -> str:
    begin = int(recording.twin.stamps[0])
    rows = [
        [plan.plan_id, _seconds(plan.start - begin), f"{plan.duration:.3f}", plan.outcome or "under way at the end"]
        for plan in recording.plans
    ]
    return "<h2>Executions</h2>\n" + (
        _table(("plan", "from, s", "length, s", "outcome"), rows, "", "text") if rows else "<p>None was recorded.</p>"
    )


def _changes(recording: Recording) -> str:
    begin = int(recording.twin.stamps[0])
    changes = recording.changes
    if not changes:
        return "<h2>Faults and transitions</h2>\n<p>None was recorded.</p>"
    faults = sum(change.state in FAULTS for change in changes)
    rows = [[_seconds(c.stamp - begin), c.source, c.state, c.reason] for c in changes[:MOST_CHANGES]]
    marks = ["fault" if change.state in FAULTS else "" for change in changes[:MOST_CHANGES]]
    left_off = f" The first {MOST_CHANGES} are shown." if len(changes) > MOST_CHANGES else ""
    text = f"<p>{len(changes)} changes of state, {faults} of them faults.{left_off}</p>"
    return f"<h2>Faults and transitions</h2>\n{text}\n" + _table(
        ("s", "who", "state", "reason"), rows, "", "text", marks
    )


def _details(summary: Mapping) -> str:
    tables = [
        _table(
            ("", ""),
            [[key.replace("_", " "), _readable(value)] for key, value in summary[part].items()],
            title,
            "values",
        )
        for part, title in _CIRCUMSTANCES.items()
        if summary.get(part)
    ]
    return "\n".join(["<h2>Circumstances</h2>", *tables]) if tables else ""


def _readable(value) -> str:
    """Return a value of the summary as a person reads it: rounded, without brackets and quotes."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_readable, value))
    if isinstance(value, Mapping):
        return "; ".join(f"{key}: {_readable(entry)}" for key, entry in value.items())
    return "unknown" if value is None else str(value)


def _table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], caption: str, kind: str = "", marks: Sequence[str] = ()
) -> str:
    head = "".join(f'<th scope="col">{escape(column)}</th>' for column in columns)
    lines = []
    for number, row in enumerate(rows):
        mark = f' class="{marks[number]}"' if marks and marks[number] else ""
        lines.append(f"<tr{mark}>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>")
    name = f"<caption>{escape(caption)}</caption>" if caption else ""
    style = f' class="{kind}"' if kind else ""
    return f"<table{style}>{name}<thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def _number(value, form: str) -> str:
    return "unknown" if value is None else format(value, form)


def _seconds(nanoseconds: int) -> str:
    return f"{nanoseconds / NANOSECONDS:.3f}"


#: The page that holds everything.
PAGE = "report.html"


@dataclass(frozen=True)
class Report:
    """What `write_report` wrote."""

    summary: dict
    files: tuple[Path, ...]


def write_report(recording: Recording, robot: RobotModel | None, directory: str | Path, twin: str = "") -> Report:
    """Evaluate a recording and write everything into `directory`, which is made if it does not exist.

    Args:
        twin: What simulated the twin, as the launch argument `twin` says it; empty: nobody knows.
        robot: For the tool path and the joints' units; without it, or when it has other joints than the recording, `figure8.png` is
            not written, and every joint is taken as revolute.

    Raises:
        ConstructionTwinError: If the recording cannot be evaluated; nothing is written then.
        OSError: If a file cannot be written.
    """
    if robot is not None and robot.joint_names != recording.joint_names:
        robot = None
    if robot is not None:
        linear = tuple(joint for joint, slides in zip(robot.joint_names, robot.linear) if slides)
        recording = dataclasses.replace(recording, linear=linear)
    evaluation = evaluate(recording)
    summary = {**summarise(evaluation), "twin": twin or None, "environment": environment(twin)}
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    drawings = {"figure9.png": figures.joint_figure(evaluation), "timing.png": figures.timing_figure(evaluation)}
    if robot is not None:
        drawings["figure8.png"] = figures.tool_path_figure(evaluation, robot)
    for name, drawing in drawings.items():
        drawing.savefig(directory / name)
    images = {name: (directory / name).read_bytes() for name in drawings}
    (directory / PAGE).write_text(page(summary, recording, images), encoding="utf-8")
    (directory / "table1.csv").write_text(table_csv(summary["tables"]), encoding="ascii")
    text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
    (directory / "summary.json").write_text(text, encoding="utf-8")
    names = sorted([*drawings, PAGE, "summary.json", "table1.csv"])
    return Report(summary, tuple(directory / name for name in names))


def environment(twin: str = "") -> dict:
    """Return the versions of the interpreter and libraries, and the machine; with a twin in MuJoCo that of the engine, too."""
    names = ("numpy", "scipy", *(("mujoco-core",) if twin == "mujoco" else ()))
    packages = {name: importlib.metadata.version(name) for name in names}
    return {"python": platform.python_version(), "system": platform.platform(), "cpus": os.cpu_count(), **packages}
