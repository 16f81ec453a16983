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

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation.alignment import Evaluation, evaluate
from construction_twin.evaluation.recording import Recording
from construction_twin.evaluation.tables import (
    ALIGNMENTS,
    NOTE,
    TableRow,
    entry,
    facts,
    paper_axis,
    remarks,
    summarise,
    table_csv,
    table_rows,
    unavailable,
)
from construction_twin.kinematics.chain import Chain
from construction_twin.robot.description import RobotModel

DPI = 150
PINK = "#ff3fa4"
COLOURS = ("#1f5fa8", "#d9541e", "#2f8f4e", "#8d4bb0", "#c79a00", "#4aa3c7", "#7a5c48", "#555555")
INK = "#333333"
#: Most points drawn of a path; more are not distinguishable.
PATH_POINTS = 1500


def joint_figure(evaluation: Evaluation) -> Figure:
    """Return all joints of both robots over the evaluated time: twin solid, physical dashed (the paper's Figure 9).

    Prismatic joints have a panel of their own, in m.
    """
    recording = evaluation.recording
    slides = [joint in recording.linear for joint in recording.joint_names]
    units = {False: "joint angle [rad]", True: "joint position [m]"}
    kinds = [kind for kind in units if kind in slides]
    figure, panels = _figure(9.0, 5.4 if len(kinds) == 1 else 8.1, len(kinds))
    for kind, axes in zip(kinds, panels):
        _draw_joints(axes, evaluation, [number for number, slide in enumerate(slides) if slide is kind])
        axes.set(ylabel=units[kind])
    panels[0].set(title="Joint angles of twin and physical arm")
    panels[-1].set(xlabel="time [s]")
    return figure


def _draw_joints(axes, evaluation: Evaluation, numbers: Sequence[int]) -> None:
    recording, window = evaluation.recording, evaluation.window
    for name, style, width, shade in (("twin", "-", 1.4, 1.0), ("physical", "--", 3.4, 0.45)):
        stream = getattr(recording, name)
        inside = window.contains(stream.stamps)
        seconds = (stream.stamps[inside] - window.start) / NANOSECONDS
        for number in numbers:
            joint = recording.joint_names[number]
            label = f"{paper_axis(joint) or joint} {name}"
            values = stream.positions[inside, number]
            colour = COLOURS[number % len(COLOURS)]
            order = 2 if name == "twin" else 1
            axes.plot(seconds, values, style, color=colour, lw=width, alpha=shade, label=label, zorder=order)
    axes.margins(x=0.01)
    axes.legend(ncols=2, loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8)


def tool_path_figure(evaluation: Evaluation, robot: RobotModel) -> Figure:
    """Return the tool's path in 3D with the arm at its start and end pose (the paper's Figure 8)."""
    chain = Chain(robot)
    twin = evaluation.recording.twin
    poses = twin.positions[evaluation.window.contains(twin.stamps)]
    poses = poses[:: max(1, len(poses) // PATH_POINTS)]
    path = np.array([chain.forward(q).position for q in poses])
    arms = {
        "arm at the start": (chain.skeleton(poses[0]), "#9aa3ab"),
        "arm at the end": (chain.skeleton(poses[-1]), INK),
    }
    figure = Figure(figsize=(7.0, 6.4), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d", computed_zorder=False)
    for label, (points, colour) in arms.items():
        axes.plot(*points.T, "-", color=colour, lw=7, alpha=0.55, solid_capstyle="round", zorder=2)
        axes.plot(*points.T, "o", color=colour, ms=6, mec="white", mew=0.8, label=label, zorder=3)
    axes.plot(*path.T, "-", color=PINK, lw=2.6, label="tool path", zorder=4)
    axes.plot(*path[[0, -1]].T, "o", color=PINK, ms=5, mec="white", zorder=5)
    _frame_3d(axes, np.vstack([path, *(points for points, _ in arms.values())]))
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title=f"Tool path of the task, in {robot.base_link}")
    axes.legend(loc="upper left", frameon=False, fontsize=8)
    return figure


def _figure(width: float, height: float, rows: int) -> tuple[Figure, list]:
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, squeeze=False)[:, 0]
    for axes in panels:
        axes.grid(color="#dddddd", lw=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, list(panels)


def _frame_3d(axes, points: np.ndarray) -> None:
    """Show all points and the floor at equal scale."""
    points = np.vstack([points, [0.0, 0.0, 0.0]])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.08 * (high - low).max()
    low, high = low - margin, high + margin
    low[2] = min(0.0, low[2] + margin)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low)
    axes.view_init(elev=22, azim=-58)


#: Most rows of the table of state changes; a bag of an unstable link may hold thousands.
MOST_CHANGES = 500
#: Words of states that are faults.
FAULTS = {
    "HOLDING", "STALE", "STOPPED", "FAULT", "REFUSING", "REPLANNING", "HELD",
    "DISCONNECTED", "GATEWAY_OFFLINE", "NO_CONTROLLER", "MISMATCH", "OTHER_ARM", "NEEDS_RESET",
}  # fmt: skip
_HEADINGS = {
    "figure8.png": "Tool path (the paper's Figure 8)",
    "figure9.png": "Joints (the paper's Figure 9)",
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
    """Return the page: ASCII except for text from the recording."""
    title = f"Twin and physical arm: {summary['robot']}"
    sections = [
        f"<h1>{escape(title)}</h1>", _facts(summary), *_error_tables(summary), *_figures(drawings), _timing(summary),
        _plans(recording), _changes(recording), _details(summary),
    ]  # fmt: skip
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
    figures = [f"{entry(value, '.4e')} {unit}" for value in errors]
    paper = [entry(value, ".4e") for value in (row.paper_avg_rad, row.paper_max_rad)]
    return [row.joint, *figures, *paper, entry(row.avg_ratio, ".3g"), entry(row.max_ratio, ".3g")]


def _figures(drawings: Mapping[str, bytes]) -> Iterable[str]:
    for name in sorted(drawings):
        heading = escape(_HEADINGS.get(name, name))
        data = base64.b64encode(drawings[name]).decode("ascii")
        yield f'<h2>{heading}</h2>\n<img alt="{heading}" src="data:image/png;base64,{data}">'


def _timing(summary: Mapping) -> str:
    names = ("p50", "p99", "p99_9", "max")
    times = (("round trip, ms", "round_trip_ms", ".3f"), ("RSI reply time, us", "reply_us", ".0f"))
    rows = [[label, *(entry(summary[key].get(name), form) for name in names)] for label, key, form in times]
    table = _table(("", "p50", "p99", "p99.9", "max"), rows, "Latency")
    rates = [[name, entry(rate, ".3f")] for name, rate in summary["rate_hz"].items()]
    counts = [
        [key.replace("_", " "), entry(summary[key], "d")] for key in ("commands_sent", "commands_lost", "late_replies")
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
    tables = []
    for part, title in _CIRCUMSTANCES.items():
        rows = [[key.replace("_", " "), _readable(value)] for key, value in (summary.get(part) or {}).items()]
        tables += [_table(("", ""), rows, title, "values")] if rows else []
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
        twin: What simulated the twin, as the launch argument `twin` says it; empty: unknown.
        robot: For the tool path and the joints' units; None, or with other joints than the recording: `figure8.png` is left out,
            and every joint is taken as revolute.
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
    drawings = {"figure9.png": joint_figure(evaluation)}
    if robot is not None:
        drawings["figure8.png"] = tool_path_figure(evaluation, robot)
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
