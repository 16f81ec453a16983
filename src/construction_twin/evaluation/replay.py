"""A recorded run in a form that a browser can play: poses on a grid of time, the error over time, marks, the report's figures.

In: an evaluated recording. Out: a mapping for JSON, bounded in size whatever the recording's length. `write_report` writes it as
``replay.json`` beside the report, and the console's page plays it (web/src/replay/). Pure: no file, no clock, no ROS.

Numbers are integers, which keeps the file small: poses in 10 µrad or 10 µm, errors in nrad or nm. A pose is the newest one at its
time, as somebody who watched would have seen it; where none had come for a while it is null, and nothing is made up. An error is
the largest one since the row before, so that no peak is lost between two rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation.alignment import Window, align_by_command, align_instant
from construction_twin.evaluation.page import FAULTS
from construction_twin.evaluation.recording import Recording, Stream
from construction_twin.evaluation.summary import Evaluation
from construction_twin.evaluation.tables import table_rows

#: The file's name, and what it says of itself; another version is refused by the page.
FILE, FORMAT, VERSION = "replay.json", "construction_twin replay", 1
#: Shortest time between two rows [ns]: 50 Hz. A long recording has longer ones.
PERIOD_NS = 20_000_000
#: Most rows, and most numbers of one body in all of them.
MOST_ROWS, MOST_NUMBERS = 15_000, 150_000
#: Most marks, and the longest text in one.
MOST_MARKS, LONGEST_TEXT = 500, 300
#: A pose counts for so long; from then on nothing is known [ns].
KNOWN_FOR_NS = NANOSECONDS // 2
#: Units of the integers: this many are a radian or a metre.
POSITION_SCALE, ERROR_SCALE = 1e5, 1e9
#: Largest integer that a browser keeps exactly.
_LARGEST = 2**53 - 1


def replay_of(evaluation: Evaluation, summary: Mapping) -> dict:
    """Return the content of ``replay.json``; every value is JSON-ready.

    Args:
        summary: As `summary.summarise` returns it.
    """
    recording = evaluation.recording
    names, linear = recording.joint_names, recording.linear
    stamps = np.concatenate([recording.twin.stamps, recording.physical.stamps])
    begin, end = int(stamps.min()), int(stamps.max())
    period = _period(end - begin, len(names))
    # stamps are int64 and far from their ends; one row more than there are periods
    grid = begin + np.arange((end - begin) // period + 1, dtype=np.int64) * period
    alignment, errors = _errors(recording, grid, period, end)
    marks = _marks(recording, begin)
    shown = _most_important(marks)
    return {
        "format": FORMAT,
        "version": VERSION,
        "robot": recording.robot.strip("/"),
        "joints": list(names),
        "types": ["prismatic" if name in linear else "revolute" for name in names],
        "begin": begin / NANOSECONDS,
        "period": period / NANOSECONDS,
        "twin": _poses(recording.twin, grid),
        "arm": _poses(recording.physical, grid),
        "errors": errors,
        "alignment": alignment,
        "marks": shown,
        "marks_left_out": len(marks) - len(shown),
        "report": _report(summary, alignment),
    }


def _period(span: int, joints: int) -> int:
    """Return the time between two rows [ns], of a recording of `span` [ns]."""
    rows = max(1, min(MOST_ROWS, MOST_NUMBERS // joints) - 1)
    return max(PERIOD_NS, -(-span // rows))


def _poses(stream: Stream, grid: np.ndarray) -> list[list[int] | None]:
    """Return the newest pose at each time of the grid; None where it is too old, or none had come."""
    # a sample that is not later than all before it is of a restarted or repeated stream
    newest = np.maximum.accumulate(stream.stamps)
    rising = np.concatenate([[True], stream.stamps[1:] > newest[:-1]])
    stamps, positions = stream.stamps[rising], stream.positions[rising]
    at = np.searchsorted(stamps, grid, side="right") - 1
    rows = _integers(positions[np.maximum(at, 0)], POSITION_SCALE)
    known = (at >= 0) & (grid - stamps[np.maximum(at, 0)] <= KNOWN_FOR_NS)
    return [row if there else None for row, there in zip(rows, known.tolist())]


def _errors(recording: Recording, grid: np.ndarray, period: int, end: int) -> tuple[str, list[list[int] | None]]:
    """Return how both were compared, and per row the largest error of each joint since the row before."""
    window = Window(int(grid[0]), end, end, False)
    aligned = align_by_command(recording, window) or align_instant(recording, window)
    # what came in (row - 1, row] belongs to the row
    row = np.clip(-(-(aligned.stamps - grid[0]) // period), 0, len(grid) - 1)
    peaks = np.full((len(grid), len(recording.joint_names)), -1.0)
    np.maximum.at(peaks, row, np.abs(aligned.errors))
    known = peaks[:, 0] >= 0
    rows = _integers(peaks, ERROR_SCALE)
    return aligned.name, [each if there else None for each, there in zip(rows, known.tolist())]


def _integers(values: np.ndarray, scale: float) -> list[list[int]]:
    return np.rint(np.clip(values * scale, -_LARGEST, _LARGEST)).astype(np.int64).tolist()


def _marks(recording: Recording, begin: int) -> list[dict]:
    """Return what happened, in order of time."""
    marks = [
        _mark(change.stamp, begin, change.source, change.state, change.reason, change.state in FAULTS)
        for change in recording.changes
    ]
    marks += [
        _mark(
            verdict.stamp, begin, "review", "approved" if verdict.approved else "rejected", verdict.reason, False,
            verdict.reviewer,
        )
        for verdict in recording.verdicts
    ]  # fmt: skip
    return sorted(marks, key=lambda mark: mark["time"])


def _mark(stamp: int, begin: int, source: str, state: str, reason: str, fault: bool, by: str = "") -> dict:
    texts = {"source": source, "state": state, "reason": reason, "by": by}
    cut = {name: text[:LONGEST_TEXT] for name, text in texts.items()}
    # what a latched topic repeats is from before the recording
    return {"time": max(0, stamp - begin) / NANOSECONDS, **cut, "fault": fault}


def _most_important(marks: list[dict]) -> list[dict]:
    """Return at most `MOST_MARKS`, in order of time: faults and verdicts before other changes."""
    ranked = sorted(range(len(marks)), key=lambda k: not (marks[k]["fault"] or marks[k]["source"] == "review"))
    return [marks[k] for k in sorted(ranked[:MOST_MARKS])]


def _report(summary: Mapping, alignment: str) -> dict:
    """Return the figures of the report that stand beside the picture: Table 1 of one alignment, and of the whole run."""
    rows: Iterable = (row for row in table_rows(summary["tables"]) if row.alignment == alignment)
    table = [
        {
            "joint": row.joint,
            "average": row.avg_rad if row.avg_m is None else row.avg_m,
            "largest": row.max_rad if row.max_m is None else row.max_m,
            "paper_average": row.paper_avg_rad,
            "paper_largest": row.paper_max_rad,
        }
        for row in rows
    ]
    return {
        "table": [row for row in table if row["average"] is not None],
        "duration": summary["duration_s"],
        "samples": summary["samples"],
        "waypoints": summary["waypoints"],
        "lag": summary["lag_s"],
        "commands_lost": summary["commands_lost"],
        "late_replies": summary["late_replies"],
        "round_trip_ms": summary["round_trip_ms"]["p50"],
        "mock": bool(summary["mock"]),
    }
