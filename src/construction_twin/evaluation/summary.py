"""Evaluates a recording: the alignments, and all figures of `summary.json` as one mapping. None: unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from construction_twin.core.histogram import percentile
from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation import alignment
from construction_twin.evaluation.alignment import Alignment, Window
from construction_twin.evaluation.recording import LinkSnapshot, Recording, Stream
from construction_twin.evaluation.tables import NOTE, PERCENTILES, SAMPLES, TABLE_1, WAYPOINTS, error_table, percentiles

#: A twin of which no joint goes further than this has not moved [rad], [m].
MOTION = 1e-3
_MOCK_LIMITS = ("start_pose_deg", "correction_lower_deg", "correction_upper_deg", "correction_monitor_deg")


@dataclass(frozen=True)
class Evaluation:
    """A recording with its alignments; `lag_ns`: estimated constant lag [ns]."""

    recording: Recording
    window: Window
    lag_ns: float | None
    alignments: dict[str, Alignment | None]


def evaluate(recording: Recording) -> Evaluation:
    """Align a recording by every method for which it holds the data.

    The window is that of `task_window`, extended by the median round trip and the lag, so that the samples which answer the last
    waypoint belong to it.
    """
    window = alignment.task_window(recording)
    trips = alignment.round_trips(recording, window)
    round_trip = int(np.median(trips) * NANOSECONDS) if len(trips) else 0
    lag_ns = alignment.estimate_lag(recording, window.extended(round_trip))
    window = window.extended(round_trip + int(lag_ns or 0))
    return Evaluation(
        recording=recording,
        window=window,
        lag_ns=lag_ns,
        alignments={
            "by_command": alignment.align_by_command(recording, window),
            "instant": alignment.align_instant(recording, window),
            "expected": alignment.align_expected(recording, window),
            "lag_removed": None if lag_ns is None else alignment.align_lag_removed(recording, window, lag_ns),
        },
    )


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
        "round_trip_ms": percentiles(alignment.round_trips(recording, window) * 1e3),
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
    """Return a snapshot from before the window and one from after it, or the closest ones available.

    The gateway's counters reach the bridge once a second, so only a snapshot at least 1 s after the window's end is
    sure to include it; the span between the two is up to 3 s longer than the window.
    """
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
