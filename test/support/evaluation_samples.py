"""Synthetic runs with a known lag and error, for the evaluation's tests."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.evaluation.recording import FeedbackStream, LinkSnapshot, PlayedPlan, Recording, Stream

JOINTS = tuple(f"joint_a{number}" for number in range(1, 7))
#: A stamp of today's size: differences must survive float64.
BASE = 1_790_000_000 * NANOSECONDS
IDLE_S = 1.0
AMPLITUDE = np.array([0.9, 0.7, -0.6, 1.1, 0.8, -1.3])
ROUND_TRIP_NS = 23_000_000


def rounded(q, decimals):
    """Return joint angles [rad] as a wire with that many decimals of a degree carries them; all of them for None."""
    return np.asarray(q) if decimals is None else np.radians(np.round(np.degrees(q), decimals))


def twin_stream(duration: float, decimals: int | None = None) -> Stream:
    """Return a reach of `duration` [s] between two seconds of rest, on the 4 ms grid from `BASE`."""
    seconds = np.arange(0.0, duration + 2 * IDLE_S, 0.004)
    s = np.clip((seconds - IDLE_S) / duration, 0.0, 1.0)
    shape = s**3 * (10 - 15 * s + 6 * s**2)
    stamps = BASE + np.arange(len(seconds), dtype=np.int64) * CYCLE_NS
    return Stream(stamps, rounded(shape[:, None] * AMPLITUDE, decimals), stamps + 500_000)


def interpolated(twin: Stream, at: np.ndarray) -> np.ndarray:
    """Return the twin's pose at stamps [ns], by scipy's own cubic with numpy's own derivatives."""
    known = (twin.stamps - BASE) / 1e9
    return CubicHermiteSpline(known, twin.positions, np.gradient(twin.positions, known, axis=0))((at - BASE) / 1e9)


def run(
    duration: float = 10.0,
    lag_ns: int = 12_000_000,
    error=0.0,
    decimals: int | None = None,
    arm_decimals: int | None = None,
    plans: bool = True,
    feedback: bool = True,
    links=(),
    mock=None,
    phase_ns: int = 1_300_000,
) -> Recording:
    """Return a run whose arm follows its commands `lag_ns` late, `error` [rad] off, answering `ROUND_TRIP_NS` later."""
    twin = twin_stream(duration, decimals)
    answered = twin.stamps[50:-20] + phase_ns
    pose = rounded(interpolated(twin, answered - lag_ns) + error, arm_decimals)
    stamps = answered + ROUND_TRIP_NS
    received = stamps + 300_000
    seq = np.arange(1, len(stamps) + 1, dtype=np.uint64)
    start = BASE + round(IDLE_S * NANOSECONDS)
    return Recording(
        robot="/kr120",
        joint_names=JOINTS,
        twin=twin,
        physical=Stream(stamps, pose, received),
        feedback=FeedbackStream(stamps, pose, received, seq, answered) if feedback else None,
        command=Stream(twin.stamps, twin.positions, twin.stamps + 200_000),
        plans=(PlayedPlan("p1", start, duration, "finished"),) if plans else (),
        waypoints={"p1": 200},
        links=tuple(links),
        mock=mock,
    )


def link(second: float, sent: int, lost: int = 0, late: int = 0, counts=(0, 0, 0, 0), session="s1") -> LinkSnapshot:
    """Return a report of the bridge `second` s after `BASE`."""
    counters = {"commands_lost": str(lost), "late_replies": str(late), "decimals": "3", "reply_us_max": "431.5"}
    return LinkSnapshot(BASE + round(second * 1e9), session, sent, counters, (50, 100, 200), tuple(counts))
