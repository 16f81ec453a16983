"""From a recording to what drove the arm: the targets that the controller took, cycle by cycle, beside where the arm was.

A state without a gap before it tells one cycle. Its command stamp says which target the controller took, by the commands that
were recorded: a reply that did not arrive shows as a stamp that comes twice. Where the gateway braked, settled or stretched the
motion, the stamps lose the pace of the cycles, or the gate is closed; such rows drive the model on, and are not judged.
"""

from __future__ import annotations

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation.alignment import TwinPath
from construction_twin.evaluation.recording import Recording
from construction_twin.servo.identification import Drive
from construction_twin.servo.pace import PACE, STEADY

#: An arm whose target has not changed for so long rests [ns].
RESTED = NANOSECONDS // 5
#: Shortest stretch that is used [cycles].
SHORTEST = 100


def cycle_of(recording: Recording) -> int:
    """Return the controller's cycle [ns], in whole ms: by how much command stamps advance from state to state, mostly.

    Raises:
        ConstructionTwinError: If the recording has no command stamps.
    """
    feedback = recording.feedback
    if feedback is not None and len(feedback) > 1:
        steps = np.diff(feedback.seq.astype(np.int64)) == 1
        known = (feedback.command_stamps[1:] > 0) & (feedback.command_stamps[:-1] > 0)
        advances = np.diff(feedback.command_stamps)[steps & known]
        if len(advances) and np.median(advances) >= NANOSECONDS // 1000:
            return round(float(np.median(advances)) * 1000 / NANOSECONDS) * (NANOSECONDS // 1000)
    raise ConstructionTwinError(Sentence("view.identify.nothing"))


def drives_of(recording: Recording, cycle_ns: int) -> list[Drive]:
    """Return the stretches of a recording in which the controller's targets are known, each from rest.

    Args:
        cycle_ns: The controller's cycle [ns].

    Raises:
        ConstructionTwinError: If it holds no commands or no command stamps.
    """
    feedback, command = recording.feedback, recording.command
    if feedback is None or command is None:
        raise ConstructionTwinError(Sentence("view.identify.nothing"))
    base = int(command.stamps.min())
    path = TwinPath(command, base)
    times = (feedback.command_stamps - base).astype(float)
    known = (feedback.command_stamps > 0) & path.covers(times)
    targets = np.zeros_like(feedback.positions)
    targets[known] = path(times[known])
    advances = np.diff(feedback.command_stamps, prepend=0)
    follows = known & np.concatenate([[False], known[:-1]]) & (np.diff(feedback.seq.astype(np.int64), prepend=0) == 1)
    steady = _lasts(np.abs(advances - cycle_ns) <= cycle_ns // PACE, STEADY // cycle_ns)
    counts = steady & _lasts(_in_sync(recording), STEADY // cycle_ns)
    drives = []
    for begin, end in _stretches(known, follows):
        rows = slice(begin, end)
        rest = _first_rest(targets[rows], RESTED // cycle_ns)
        if rest is not None and end - begin - rest >= SHORTEST:
            rows = slice(begin + rest, end)
            drives.append(Drive(targets[rows], feedback.positions[rows], counts[rows]))
    return drives


def _stretches(known: np.ndarray, follows: np.ndarray) -> list[tuple[int, int]]:
    """Return begin and end of each run of rows that are known and each follow the one before."""
    begins = np.flatnonzero(known & ~follows)
    ends = np.flatnonzero(~known | ~follows)
    return [(begin, int(min(ends[ends > begin], default=len(known)))) for begin in begins.tolist()]


def _first_rest(targets: np.ndarray, cycles: int) -> int | None:
    """Return the first row at which the target has not changed for so many cycles; None when there is none."""
    still = np.concatenate([[True], (np.diff(targets, axis=0) == 0.0).all(axis=1)])
    rested = np.flatnonzero(_lasts(still, cycles))
    return int(rested[0]) if len(rested) else None


def _lasts(holds: np.ndarray, rows: int) -> np.ndarray:
    """Return at which rows something has held for so many rows, shape (m,), bool."""
    number = np.arange(len(holds))
    broken = np.maximum.accumulate(np.where(holds, -1, number))
    return number - broken >= rows


def _in_sync(recording: Recording) -> np.ndarray:
    """Return at which rows of the feedback the gate was open, as far as it reported, shape (m,), bool."""
    changes = [change for change in recording.changes if change.source == "gate"]
    stamps = recording.feedback.stamps  # type: ignore[union-attr]  # `drives_of` has seen to that
    if not changes:
        return np.ones(len(stamps), bool)
    at = np.searchsorted([change.stamp for change in changes], stamps, side="right") - 1
    open_after = np.array([change.state == "IN_SYNC" for change in changes])
    return (at >= 0) & open_after[np.maximum(at, 0)]
