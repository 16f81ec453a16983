"""The monitor's changes of state: what their file holds, and what is said of a disk that refuses it."""

from __future__ import annotations

import errno
import math
import os

import pytest

from construction_twin.core.append_only import read_lines
from construction_twin.core.errors import ConfigurationError
from construction_twin.monitor.comparison import Comparison
from construction_twin.monitor.monitor import TransitionLog, transition_fields
from construction_twin.monitor.states import SyncEvent, SyncState, Transition

NAMES = ("joint_a1", "joint_a2")
AT = 1_790_000_000_123_456_789


def change(number: int = 0, physical=(0.02, 0.0)) -> Transition:
    comparison = Comparison(AT, "aligned", (0.0, 0.0), physical, (0.01, 0.015), 0.02, 0.008)
    return Transition(
        AT + number, SyncState.IN_SYNC, SyncState.HOLDING, SyncEvent.POSE_DIFFERS, f"why {number}", comparison, AT - 5
    )


def test_a_line_holds_time_states_event_reason_and_values(tmp_path):
    log = TransitionLog(tmp_path / "log.jsonl", NAMES)
    log.add(change())
    log.flush()
    assert read_lines(tmp_path / "log.jsonl") == [
        {
            "time": "2026-09-21T14:13:20.123456789Z",
            "time_ns": AT,
            "from": "IN_SYNC",
            "to": "HOLDING",
            "event": "pose_differs",
            "reason": "why 0",
            "error": {"joint_a1": 0.02, "joint_a2": 0.0},
            "threshold": {"joint_a1": 0.01, "joint_a2": 0.015},
            "held_stamp_ns": AT - 5,
        }
    ]


def test_what_is_no_number_is_written_as_null():
    assert transition_fields(change(physical=(math.nan, math.inf)), NAMES)["error"] == dict.fromkeys(NAMES)


def test_without_a_comparison_there_are_no_values():
    first = Transition(AT, SyncState.WAITING, SyncState.WAITING, SyncEvent.STARTED, "started", None, 0)
    assert transition_fields(first, NAMES)["error"] == transition_fields(first, NAMES)["threshold"] == {}


def test_a_disk_that_refuses_is_named_until_it_takes_what_was_kept(tmp_path, monkeypatch):
    log = TransitionLog(tmp_path / "log.jsonl", NAMES)
    log.add(change())

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        log.flush()
    assert "No space left on device" in log.fault and (tmp_path / "log.jsonl").read_text() == ""
    log.flush()
    assert log.fault == "" and len(read_lines(tmp_path / "log.jsonl")) == 1


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(ConfigurationError, match=str(tmp_path)):
        TransitionLog(tmp_path, NAMES)
