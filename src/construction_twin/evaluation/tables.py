"""The paper's Table 1 for this run: error figures per joint, as data, as CSV and on the terminal, made of `summary.json`."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from construction_twin.core.histogram import percentile
from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation.alignment import Alignment, Evaluation, Window, round_trips
from construction_twin.evaluation.recording import LinkSnapshot, Recording, Stream


@dataclass(frozen=True)
class PaperError:
    """One column pair of the paper's Table 1: mean and largest absolute error of a joint between both robots [rad]."""

    average: float
    maximum: float


TABLE_1 = {
    "A1": PaperError(1.5269e-06, 1.7232e-06),
    "A2": PaperError(1.9848e-06, 2.2391e-06),
    "A3": PaperError(2.2334e-05, 2.0717e-05),
    "A4": PaperError(2.2993e-07, 2.8146e-07),
    "A5": PaperError(6.2252e-06, 7.0128e-06),
    "A6": PaperError(4.3442e-06, 3.9486e-06),
}
#: Waypoints of the virtual robot and samples of the physical robot (section 4.2).
WAYPOINTS = 1500
SAMPLES = 18802
NOTE = "the paper's Table 1 prints averages above the maxima for A3 and A6, so those two columns cannot both be right"


def paper_axis(joint: str) -> str | None:
    """Return the paper's name of a joint (``joint_a1`` is ``A1``), or None when the paper has no such joint."""
    match = re.search(r"a([1-6])$", joint)
    return f"A{match.group(1)}" if match else None


def paper_error(joint: str) -> PaperError | None:
    """Return the paper's Table 1 figures of a joint, or None when the paper has no such joint."""
    axis = paper_axis(joint)
    return TABLE_1[axis] if axis else None


#: The alignments in the order they are printed, with what each compares.
ALIGNMENTS = {
    "by_command": "physical against the twin's pose for the same command",
    "instant": "physical against the twin's pose at the same ROS time",
    "lag_removed": "by_command with one constant lag taken out",
    "expected": "physical against where the model of its servos has the arm",
}
#: What an alignment needs that not every run has.
NEEDS = {"expected": "a run with the launch argument servo_model has it"}
SIMULATION = "This is a simulation: the arm was the mock controller of this package, not a robot."
ARM_UNKNOWN = (
    "The recording has no mock_rsi/status: the arm was a robot, or this is a simulation whose status was not recorded."
)
NO_MOTION = "Nothing moved while this was recorded: the figures say nothing of how twin and arm agree in motion."
#: Columns of what is no terminal.
_WIDEST = 10_000
#: Names and fractions of the reported percentiles.
PERCENTILES = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999}


def unavailable(alignment: str) -> str:
    """Return why there is no table of an alignment."""
    needs = NEEDS.get(alignment, "the recording does not hold what it needs")
    return f"{alignment}: not available, {needs} ({ALIGNMENTS[alignment]})"


def error_table(alignment: Alignment | None, joint_names: Sequence[str], linear: Sequence[str] = ()) -> dict | None:
    """Return ``{joint: {"avg_rad", "max_rad"}}`` of an alignment; ``avg_m`` and ``max_m`` for the joints in `linear`."""
    if alignment is None:
        return None
    table = {}
    for name, average, maximum in zip(joint_names, alignment.average, alignment.maximum):
        unit = "m" if name in linear else "rad"
        table[name] = {f"avg_{unit}": float(average), f"max_{unit}": float(maximum)}
    return table


def percentiles(values: np.ndarray) -> dict[str, float | None]:
    """Return p50, p99, p99_9 and max of `values`, shape (k,), in their own unit; all None when empty."""
    if not len(values):
        return dict.fromkeys([*PERCENTILES, "max"])
    fractions = {name: float(np.quantile(values, fraction)) for name, fraction in PERCENTILES.items()}
    return {**fractions, "max": float(np.max(values))}


class TableRow(NamedTuple):
    """The figures of one joint in one alignment, in the order of the CSV file; None: unknown, or of the other kind of joint."""

    alignment: str
    joint: str
    avg_rad: float | None
    max_rad: float | None
    paper_avg_rad: float | None
    paper_max_rad: float | None
    avg_ratio: float | None
    max_ratio: float | None
    avg_m: float | None
    max_m: float | None


#: Columns of the CSV file for a robot without prismatic joints, and the further ones otherwise.
CSV_COLUMNS = TableRow._fields[:-2]
LINEAR_COLUMNS = TableRow._fields[-2:]


def table_rows(tables: Mapping) -> Iterator[TableRow]:
    """Yield the figures of every alignment and joint."""
    joints: Mapping = next((table for table in tables.values() if table), {})
    for alignment in ALIGNMENTS:
        table = tables.get(alignment)
        for joint in joints:
            entry = table[joint] if table else {}
            average, maximum = entry.get("avg_rad"), entry.get("max_rad")
            paper = paper_error(joint)
            yield TableRow(
                alignment,
                joint,
                avg_rad=average,
                max_rad=maximum,
                paper_avg_rad=paper.average if paper else None,
                paper_max_rad=paper.maximum if paper else None,
                avg_ratio=_ratio(average, paper.average if paper else None),
                max_ratio=_ratio(maximum, paper.maximum if paper else None),
                avg_m=entry.get("avg_m"),
                max_m=entry.get("max_m"),
            )


def table_csv(tables: Mapping) -> str:
    """Return `table_rows` as CSV text with a header line; `LINEAR_COLUMNS` only where there is a prismatic joint."""
    rows = list(table_rows(tables))
    prismatic = any(row.avg_m is not None for row in rows)
    columns = CSV_COLUMNS + LINEAR_COLUMNS if prismatic else CSV_COLUMNS
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(row[: len(columns)] for row in rows)
    return text.getvalue()


def table_console(markup: bool = True) -> Console:
    """Return a console for tables: into a pipe or a file they are as wide as they need, on a terminal as wide as that."""
    console = Console(highlight=False, markup=markup)
    if not console.is_terminal:
        console.width = _WIDEST
    return console


def render_tables(summary: Mapping, console: Console | None = None) -> None:
    """Print a summary: one table per alignment beside the paper's figures, then lag, counts, rates and times.

    `console`: Default: standard output.
    """
    console = console or table_console()
    rows = list(table_rows(summary["tables"]))
    for alignment, meaning in ALIGNMENTS.items():
        if summary["tables"].get(alignment) is None:
            console.print(f"\n{unavailable(alignment)}", soft_wrap=True)
            continue
        console.print()
        console.print(_rich_table(f"{alignment}: {meaning}", [row for row in rows if row.alignment == alignment]))
    console.print(f"\nNote: {NOTE}.", soft_wrap=True)
    for line in summary_lines(summary):
        console.print(line, soft_wrap=True, markup=False)


def summary_lines(summary: Mapping) -> list[str]:
    """Return the sentences below the tables."""
    fact_lines = [f"{name}: {value}" + (f" (paper {paper})" if paper else "") for name, value, paper in facts(summary)]
    rates = "rates: " + "   ".join(f"{name} {entry(rate, '.3f')} Hz" for name, rate in summary["rate_hz"].items())
    times = [_times("round trip", summary["round_trip_ms"], "ms"), _times("RSI reply time", summary["reply_us"], "us")]
    return [*fact_lines, *times, rates, *remarks(summary)]


def remarks(summary: Mapping) -> list[str]:
    """Return remarks on the figures: the kind of arm, and a run without motion."""
    return [*([] if summary["moved"] else [NO_MOTION]), SIMULATION if summary["mock"] else ARM_UNKNOWN]


def facts(summary: Mapping) -> list[tuple[str, str, str]]:
    """Return name, value and the paper's value of each figure of the whole recording, without latencies and rates."""
    lag = summary["lag_s"]
    return [
        ("duration", f"{summary['duration_s']:.3f} s", ""),
        ("samples", entry(summary["samples"]), str(SAMPLES)),
        ("waypoints", entry(summary["waypoints"]), str(WAYPOINTS)),
        ("decimals on the wire", entry(summary["decimals"]), ""),
        ("servo", entry(summary["servo"]), ""),
        *([("twin", summary["twin"], "")] if summary.get("twin") else []),
        ("lag taken out in lag_removed", "unknown" if lag is None else f"{lag * 1e3:.6f} ms", ""),
        ("commands sent", entry(summary["commands_sent"]), ""),
        ("commands lost", entry(summary["commands_lost"]), ""),
        ("late RSI replies", entry(summary["late_replies"]), ""),
        ("largest final error", _final_errors(summary), ""),
    ]


def _rich_table(title: str, rows: Sequence[TableRow]) -> Table:
    # at most 80 columns, so that a log or a narrow terminal does not cut figures off
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("joint", no_wrap=True)
    for heading in ("avg, rad", "max, rad", "paper avg", "paper max", "avg/paper", "max/paper"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        joint, errors = row.joint, (row.avg_rad, row.max_rad)
        if row.avg_m is not None:
            joint, errors = f"{row.joint} [m]", (row.avg_m, row.max_m)
        figures = [entry(value, ".4e") for value in (*errors, row.paper_avg_rad, row.paper_max_rad)]
        table.add_row(joint, *figures, entry(row.avg_ratio, ".3g"), entry(row.max_ratio, ".3g"))
    return table


def _final_errors(summary: Mapping) -> str:
    errors = {unit: summary.get(f"final_error_{unit}") for unit in ("rad", "m")}
    return ", ".join(f"{max(values.values()):.3e} {unit}" for unit, values in errors.items() if values)


def _times(name: str, figures: Mapping, unit: str) -> str:
    parts = [
        f"{key.replace('_', '.')} {entry(value, '.3f' if unit == 'ms' else '.0f')}" for key, value in figures.items()
    ]
    return f"{name} [{unit}]: " + "   ".join(parts)


def entry(value, form: str = "") -> str:
    """Return a figure as a table's entry; None: ``unknown``."""
    return "unknown" if value is None else format(value, form)


def _ratio(value: float | None, reference: float | None) -> float | None:
    return None if value is None or reference is None else value / reference


# -- summary.json

#: A twin of which no joint goes further than this has not moved [rad], [m].
MOTION = 1e-3
_MOCK_LIMITS = ("start_pose_deg", "correction_lower_deg", "correction_upper_deg")


def summarise(evaluation: Evaluation) -> dict:
    """Return the content of `summary.json`, without ``environment``; every value is JSON-ready."""
    recording, window = evaluation.recording, evaluation.window
    names = recording.joint_names
    first, last = link_span(recording.links, window)
    tables = {name: error_table(aligned, names, recording.linear) for name, aligned in evaluation.alignments.items()}
    final_error = np.abs(recording.physical.positions[-1] - recording.twin.positions[-1])
    poses = recording.twin.positions[window.contains(recording.twin.stamps)]
    mock = _mock_settings(recording.mock) if recording.mock else None
    return {
        "waypoints": _waypoints(recording),
        "samples": int(np.count_nonzero(window.contains(recording.physical.stamps))),
        "duration_s": window.duration,
        "decimals": last.counter("decimals") if last else None,
        "servo": mock.get("servo") if mock else None,
        "lag_s": None if evaluation.lag_ns is None else evaluation.lag_ns / NANOSECONDS,
        "tables": tables,
        "commands_sent": _commands_sent(first, last),
        "commands_lost": _increase(first, last, "commands_lost"),
        "late_replies": _increase(first, last, "late_replies"),
        "reply_us": reply_times(first, last),
        "round_trip_ms": percentiles(round_trips(recording, window) * 1e3),
        "rate_hz": {name: rate(getattr(recording, name), window) for name in ("twin", "physical", "command")},
        "final_error_rad": {n: e for n, e in zip(names, final_error.tolist()) if n not in recording.linear},
        "final_error_m": {n: e for n, e in zip(names, final_error.tolist()) if n in recording.linear},
        "moved": bool(np.abs(poses - poses[:1]).max(initial=0.0) > MOTION),
        "robot": recording.robot,
        "skipped_samples": {name: aligned and aligned.skipped for name, aligned in evaluation.alignments.items()},
        "mock": mock,
        "paper": {
            "table1": {axis: {"avg_rad": e.average, "max_rad": e.maximum} for axis, e in TABLE_1.items()},
            "waypoints": WAYPOINTS,
            "samples": SAMPLES,
            "note": NOTE,
        },
    }


def link_span(links: tuple[LinkSnapshot, ...], window: Window) -> tuple[LinkSnapshot | None, LinkSnapshot | None]:
    """Return a snapshot from at least 1 s before the window and one from after it, or the closest ones available."""
    if not links:
        return None, None
    before = [link for link in links if link.received <= window.start]
    after = [link for link in links if link.received >= window.end + NANOSECONDS]
    return before[-1] if before else links[0], after[0] if after else links[-1]


def reply_times(first: LinkSnapshot | None, last: LinkSnapshot | None) -> dict[str, float | None]:
    """Return p50, p99, p99_9 and max of the gateway's RSI reply times between two snapshots [us].

    All are upper bin edges of the gateway's histogram, 10 % apart, or the largest time since the gateway's start where that
    is smaller.
    """
    result: dict = dict.fromkeys([*PERCENTILES, "max"])
    counts = reply_counts(first, last)
    if last is None or not sum(counts):
        return result
    largest = last.counter("reply_us_max")
    for name, fraction in {**PERCENTILES, "max": 1.0}.items():
        edges = (percentile(last.reply_bins, counts, fraction), largest)
        result[name] = min((edge for edge in edges if edge is not None), default=None)
    return result


def reply_counts(first: LinkSnapshot | None, last: LinkSnapshot | None) -> list[int]:
    """Return the histogram's counts between two snapshots; empty when they do not belong together."""
    if first is None or last is None or not last.reply_bins or first.reply_bins != last.reply_bins:
        return []
    counts = [new - old for new, old in zip(last.reply_counts, first.reply_counts)]
    return counts if min(counts) >= 0 else []


def rate(stream: Stream | None, window: Window) -> float | None:
    """Return the mean rate of reception inside the window [Hz], None with fewer than two messages there."""
    if stream is None:
        return None
    received = stream.received[window.contains(stream.received)]
    if len(received) < 2 or received[-1] <= received[0]:
        return None
    return (len(received) - 1) * NANOSECONDS / float(received[-1] - received[0])


def _mock_settings(status: Mapping) -> dict:
    """Return the mock's configuration; limits not set there are replaced by those in effect."""
    in_effect = {key: status[key] for key in _MOCK_LIMITS if key in status}
    return {**status.get("config", {}), **in_effect}


def _waypoints(recording: Recording) -> int | None:
    counts = [recording.waypoints.get(plan.plan_id) for plan in recording.finished_plans]
    known = [count for count in counts if count is not None]
    return sum(known) if known and len(known) == len(counts) else None


def _commands_sent(first: LinkSnapshot | None, last: LinkSnapshot | None) -> int | None:
    # The count starts with the bridge; a different session may mean a restarted bridge.
    if first is None or last is None or first is last or first.session != last.session:
        return None
    return last.commands_sent - first.commands_sent


def _increase(first: LinkSnapshot | None, last: LinkSnapshot | None, name: str) -> int | None:
    if first is None or last is None or first is last:
        return None
    if not first.counters or not last.counters or (name in first.counters and name not in last.counters):
        return None
    # The gateway lists a counter from its first use on; a counter that decreases means that the gateway was restarted.
    before, after = (link.counter(name) if name in link.counters else 0 for link in (first, last))
    return None if before is None or after is None or after < before else int(after - before)
