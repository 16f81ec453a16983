"""The transition log: every change on a line of its own, nothing overwritten, nothing lost while the disk is full."""

from __future__ import annotations

import errno
import json
import math
import os

import pytest
from sentence_checks import says

from construction_twin.core.errors import ConfigurationError, TransitionLogError
from construction_twin.monitor import transition_log as sync_log
from construction_twin.monitor.comparison import Comparison
from construction_twin.monitor.states import SyncEvent, SyncState, Transition
from construction_twin.monitor.transition_log import KEPT, TransitionLog, transition_fields

NAMES = ("joint_a1", "joint_a2")
AT = 1_790_000_000_123_456_789


def change(number: int = 0, physical=(0.02, 0.0)) -> Transition:
    comparison = Comparison(AT, "aligned", (0.0, 0.0), physical, (0.01, 0.015), 0.02, 0.008)
    return Transition(
        AT + number, SyncState.IN_SYNC, SyncState.HOLDING, SyncEvent.POSE_DIFFERS, f"why {number}", comparison, AT - 5
    )


def lines(path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_line_holds_time_states_event_reason_and_values():
    assert transition_fields(change(), NAMES) == {
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


def test_what_is_no_number_is_written_as_null():
    assert transition_fields(change(physical=(math.nan, math.inf)), NAMES)["error"] == dict.fromkeys(NAMES)


def test_without_a_comparison_there_are_no_values():
    first = Transition(AT, SyncState.WAITING, SyncState.WAITING, SyncEvent.STARTED, "started", None, 0)
    assert transition_fields(first, NAMES)["error"] == transition_fields(first, NAMES)["threshold"] == {}


def test_appends_to_what_is_there(tmp_path):
    path = tmp_path / "deep" / "log.jsonl"
    for number in range(3):
        log = TransitionLog(path, NAMES)
        log.defer(change(number))
        assert log.written == 0
        log.flush()
        assert log.written == 1
        log.close()
    assert [line["reason"] for line in lines(path)] == ["why 0", "why 1", "why 2"]


def test_goes_on_on_a_new_line_behind_half_a_line(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_text('{"time": "20')
    log = TransitionLog(path, NAMES)
    log.defer(change())
    log.flush()
    first, second = path.read_text().splitlines()
    assert first == '{"time": "20' and json.loads(second)["reason"] == "why 0"


def test_keeps_what_the_disk_refuses(tmp_path, monkeypatch):
    path = tmp_path / "log.jsonl"
    log = TransitionLog(path, NAMES)
    write = os.write

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(sync_log.os, "write", full)
    for number in range(KEPT + 2):
        log.defer(change(number))
    with pytest.raises(
        TransitionLogError, check=says("reason.transitions_kept", problem="[Errno 28] No space left on device")
    ):
        log.flush()
    assert (log.lost, log.written) == (2, 0)
    monkeypatch.setattr(sync_log.os, "write", lambda file, data: write(file, data[:10]))
    with pytest.raises(TransitionLogError, match="only 10 of"):
        log.flush()
    monkeypatch.setattr(sync_log.os, "write", write)
    log.flush()
    cut, *whole = path.read_text().splitlines()
    assert len(cut) == 10
    assert [json.loads(line)["reason"] for line in whole] == [f"why {number}" for number in range(2, KEPT + 2)]


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(ConfigurationError, match="transition log"):
        TransitionLog(tmp_path, NAMES)
