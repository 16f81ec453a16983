"""A run as a browser plays it: poses on a grid, peaks of the error, marks, bounded whatever the recording is."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from evaluation_samples import BASE, JOINTS, link, run
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation.recording import RecordedVerdict, Recording, StateChange, Stream
from construction_twin.evaluation.replay import (
    ERROR_SCALE,
    FILE,
    FORMAT,
    LONGEST_TEXT,
    MOST_MARKS,
    MOST_NUMBERS,
    MOST_ROWS,
    POSITION_SCALE,
    VERSION,
    replay_of,
)
from construction_twin.evaluation.report import write_report
from construction_twin.evaluation.summary import evaluate, summarise


def played(recording: Recording) -> dict:
    evaluation = evaluate(recording)
    return replay_of(evaluation, summarise(evaluation))


def rows(replay: dict, name: str, scale: float) -> np.ndarray:
    """Rows as floats, nan where there is none."""
    joints = len(replay["joints"])
    return np.array([[np.nan] * joints if row is None else row for row in replay[name]], dtype=float) / scale


def at(seconds: float) -> int:
    return BASE + round(seconds * NANOSECONDS)


def test_poses_are_those_of_the_recording_at_fifty_a_second():
    recording = run(duration=3.0)
    made = played(recording)
    assert (made["format"], made["version"], made["robot"], tuple(made["joints"])) == (FORMAT, VERSION, "kr120", JOINTS)
    assert made["period"] == pytest.approx(0.02) and made["begin"] == pytest.approx(BASE / 1e9)
    twin = rows(made, "twin", POSITION_SCALE)
    # every fifth sample of the twin's 250 a second
    expected = recording.twin.positions[::5]
    assert np.allclose(twin[: len(expected)], expected, atol=0.51 / POSITION_SCALE)
    arm = rows(made, "arm", POSITION_SCALE)
    first = int((recording.physical.stamps[0] - BASE) // 20_000_000) + 1
    assert np.isnan(arm[:first]).all() and not np.isnan(arm[first:-1]).any()


def test_no_peak_of_the_error_is_lost_between_two_rows():
    recording = run(duration=3.0, lag_ns=0)
    positions = recording.feedback.positions.copy()
    positions[301, 2] += 0.04
    feedback = dataclasses.replace(recording.feedback, positions=positions)
    made = played(dataclasses.replace(recording, feedback=feedback))
    errors = rows(made, "errors", ERROR_SCALE)
    assert made["alignment"] == "by_command"
    assert np.nanmax(errors[:, 2]) == pytest.approx(0.04, abs=1e-6)
    row = int(np.nanargmax(errors[:, 2]))
    stamp = recording.feedback.stamps[301]
    assert BASE + (row - 1) * 20_000_000 < stamp <= BASE + row * 20_000_000


def test_without_command_stamps_the_error_is_that_of_the_same_moment():
    made = played(run(duration=3.0, feedback=False))
    assert made["alignment"] == "instant" and [row["joint"] for row in made["report"]["table"]] == list(JOINTS)


def test_where_the_arm_was_not_heard_there_is_no_pose_and_no_error():
    recording = run(duration=10.0)
    gap = (recording.physical.stamps < at(4)) | (recording.physical.stamps > at(7))
    cut = {
        name: dataclasses.replace(
            stream,
            **{each.name: getattr(stream, each.name)[gap] for each in dataclasses.fields(stream)},
        )
        for name, stream in (("physical", recording.physical), ("feedback", recording.feedback))
    }
    made = played(dataclasses.replace(recording, **cut))
    # half a second the last pose counts
    assert made["arm"][220] is not None and made["arm"][230] is None and made["arm"][345] is None
    assert made["errors"][210] is None and made["arm"][355] is not None


def test_the_figures_beside_it_are_those_of_the_report():
    evaluation = evaluate(
        run(duration=3.0, error=0.001, links=[link(0.5, 1), link(6.5, 2, lost=3)], mock={"config": {}})
    )
    summary = summarise(evaluation)
    report = replay_of(evaluation, summary)["report"]
    table = summary["tables"]["by_command"]
    assert [(row["joint"], row["average"], row["largest"]) for row in report["table"]] == [
        (joint, figures["avg_rad"], figures["max_rad"]) for joint, figures in table.items()
    ]
    assert report["table"][0]["paper_average"] == pytest.approx(1.5269e-06)
    assert report["duration"] == pytest.approx(3.0) and report["commands_lost"] == 3 and report["mock"] is False


def test_marks_are_changes_of_state_and_verdicts_in_order_of_time():
    changes = (
        StateChange(at(1.0), "gate", "IN_SYNC", ""),
        StateChange(at(3.0), "gate", "HOLDING", "joint_a1 is off"),
        # a latched report from before the recording
        StateChange(at(-50.0), "link", "ARMED", ""),
    )
    verdicts = (RecordedVerdict(at(2.0), "p1", True, "ada", ""),)
    made = played(dataclasses.replace(run(duration=3.0), changes=changes, verdicts=verdicts))
    assert [(mark["time"], mark["source"], mark["state"], mark["fault"]) for mark in made["marks"]] == [
        (0.0, "link", "ARMED", False),
        (1.0, "gate", "IN_SYNC", False),
        (2.0, "review", "approved", False),
        (3.0, "gate", "HOLDING", True),
    ]
    assert made["marks"][2]["by"] == "ada" and made["marks"][3]["reason"] == "joint_a1 is off"


def test_of_too_many_marks_faults_and_verdicts_stay():
    flapping = [StateChange(at(k / 1000), "link", "ARMED", "x" * 1000) for k in range(2 * MOST_MARKS)]
    fault = StateChange(at(2.9), "gate", "FAULT", "")
    made = played(dataclasses.replace(run(duration=3.0), changes=(*flapping, fault)))
    assert len(made["marks"]) == MOST_MARKS and made["marks_left_out"] == MOST_MARKS + 1
    assert made["marks"][-1]["state"] == "FAULT" and len(made["marks"][0]["reason"]) == LONGEST_TEXT


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.integers(0, 2**62), min_size=2, max_size=30),
    st.lists(st.integers(0, 2**62), min_size=2, max_size=30),
    st.floats(-1e300, 1e300),
)
def test_whatever_the_stamps_are_the_file_is_bounded_and_is_json(twin, arm, value):
    def stream(stamps):
        stamps = np.array(sorted(stamps), dtype=np.int64)
        return Stream(stamps, np.full((len(stamps), 1), value), stamps)

    if max(twin[0], arm[0]) >= min(twin[-1], arm[-1]) or len(set(twin)) < 2:
        return
    recording = Recording("/r", ("joint_a1",), stream(twin), stream(arm))
    try:
        evaluation = evaluate(recording)
    except Exception as error:
        # two streams that do not meet are refused by the evaluation
        assert type(error).__name__ == "ConstructionTwinError"
        return
    made = replay_of(evaluation, summarise(evaluation))
    assert len(made["twin"]) == len(made["arm"]) == len(made["errors"]) <= MOST_ROWS
    assert len(made["twin"]) * len(made["joints"]) <= MOST_NUMBERS
    json.dumps(made, allow_nan=False)


def test_the_file_stands_beside_the_report(tmp_path):
    report = write_report(run(duration=2.0), None, tmp_path)
    assert tmp_path / FILE in report.files
    assert json.loads((tmp_path / FILE).read_text())["format"] == FORMAT
