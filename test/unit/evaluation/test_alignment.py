"""Alignments and the estimate of the lag, on synthetic runs with a known lag and error."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from evaluation_samples import AMPLITUDE, BASE, JOINTS, ROUND_TRIP_NS, run, twin_stream
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.interpolation import interpolate
from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation import alignment
from construction_twin.evaluation.alignment import TwinPath, evaluate, task_window
from construction_twin.evaluation.recording import PlayedPlan, Stream


def sliced(stream, part):
    """Return a stream with only some of its samples."""
    return type(stream)(**{f.name: getattr(stream, f.name)[part] for f in dataclasses.fields(stream)})


@settings(max_examples=15, deadline=None)
@given(lag_ns=st.integers(0, 200_000_000), phase_ns=st.integers(0, 3_999_999))
def test_any_constant_lag_is_found_to_less_than_a_nanosecond(lag_ns, phase_ns):
    evaluation = evaluate(run(duration=4.0, lag_ns=lag_ns, phase_ns=phase_ns))
    assert evaluation.lag_ns == pytest.approx(lag_ns, abs=0.5)
    assert evaluation.alignments["lag_removed"].maximum.max() < 1e-9


def test_constant_error_is_reported_exactly():
    error = np.array([1e-5, -2e-5, 0.0, 3e-6, 1e-4, -5e-5])
    recording = run(lag_ns=0, error=error)
    aligned = alignment.align_by_command(recording, task_window(recording))
    np.testing.assert_allclose(aligned.average, np.abs(error), atol=1e-12)
    np.testing.assert_allclose(aligned.maximum, np.abs(error), atol=1e-12)
    np.testing.assert_allclose(aligned.errors.mean(axis=0), error, atol=1e-12)


def test_by_command_keeps_the_lag_and_instant_adds_the_round_trip():
    tables = evaluate(run(duration=10.0)).alignments
    fastest = 1.875 * np.abs(AMPLITUDE) / 10.0
    np.testing.assert_allclose(tables["by_command"].maximum, fastest * 0.012, rtol=1e-3)
    np.testing.assert_allclose(tables["instant"].maximum, fastest * (0.012 + ROUND_TRIP_NS / 1e9), rtol=1e-3)


def test_repetitive_motion_does_not_lead_to_another_period():
    def wave(stamps):
        seconds = (stamps - BASE) / 1e9
        return (np.sin(10 * np.pi * seconds) + 0.01 * seconds)[:, None] * AMPLITUDE

    recording = run(duration=6.0, lag_ns=30_000_000)
    twin = dataclasses.replace(recording.twin, positions=wave(recording.twin.stamps))
    answers = wave(recording.feedback.command_stamps - 30_000_000)
    feedback = dataclasses.replace(recording.feedback, positions=answers)
    waving = dataclasses.replace(recording, twin=twin, feedback=feedback)
    assert alignment.estimate_lag(waving, task_window(waving)) == pytest.approx(30e6, abs=2e5)


def test_interpolation_is_the_playouts_to_the_last_bit():
    twin = twin_stream(2.0)
    stamps = BASE + np.arange(1_000_000_001, 2_900_000_000, 7_777_777)
    poses = TwinPath(twin, BASE)((stamps - BASE).astype(float))
    for stamp, pose in zip(stamps, poses):
        k = int((stamp - BASE) // 4_000_000)
        before, start, end, after = ((int(twin.stamps[n]), tuple(twin.positions[n])) for n in range(k - 1, k + 3))
        assert tuple(pose) == interpolate(int(stamp), start, end, before, after)


def test_window_is_the_task_plus_what_the_arm_needs_to_answer():
    evaluation = evaluate(run(duration=75.2))
    window = evaluation.window
    assert window.start == BASE + NANOSECONDS
    assert window.end - window.task_end == pytest.approx(ROUND_TRIP_NS + 12_000_000, abs=2)
    assert window.duration == pytest.approx(75.2)
    assert 18_800 <= len(evaluation.alignments["by_command"].stamps) <= 18_820


def test_window_spans_all_finished_plans_of_the_recording_and_no_others():
    start = BASE + NANOSECONDS
    plans = (
        PlayedPlan("before", BASE - 50 * NANOSECONDS, 3.0, "finished"),
        PlayedPlan("a", start, 2.0, "finished"),
        PlayedPlan("b", start + 3 * NANOSECONDS, 2.0, "finished"),
        PlayedPlan("c", start + 6 * NANOSECONDS, 2.0, "held"),
    )
    window = task_window(dataclasses.replace(run(), plans=plans))
    assert (window.start, window.task_end) == (start, start + 5 * NANOSECONDS)


def test_without_feedback_only_instant_is_there():
    evaluation = evaluate(run(feedback=False))
    assert evaluation.lag_ns is None
    assert [name for name, aligned in evaluation.alignments.items() if aligned] == ["instant"]


def test_samples_without_a_command_stamp_are_skipped_and_counted():
    recording = run()
    stamps = recording.feedback.command_stamps.copy()
    stamps[1000:1010] = 0
    partly = dataclasses.replace(recording, feedback=dataclasses.replace(recording.feedback, command_stamps=stamps))
    whole, less = evaluate(recording).alignments["by_command"], evaluate(partly).alignments["by_command"]
    assert (less.skipped, len(whole.stamps) - len(less.stamps)) == (10, 10)


def test_repeated_and_returning_twin_stamps_are_left_out():
    twin = twin_stream(2.0)
    doubled = Stream(*(np.concatenate([a[:100], a[90:]]) for a in (twin.stamps, twin.positions, twin.received)))
    path = TwinPath(doubled, BASE)
    times = np.arange(1e9, 2e9, 3e6)
    np.testing.assert_array_equal(path(times), TwinPath(twin, BASE)(times))


def test_pose_beyond_the_twins_recording_is_skipped_not_extrapolated():
    recording = run(plans=False)
    cut = dataclasses.replace(recording, twin=sliced(recording.twin, slice(0, 1000)))
    window = dataclasses.replace(task_window(recording), end=int(recording.physical.stamps[-1]))
    aligned = alignment.align_instant(cut, window)
    assert aligned.skipped == np.count_nonzero(recording.physical.stamps > cut.twin.stamps[-1])


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda r: {"joint_names": ()}, "no joint in common"),
        (lambda r: {"twin": sliced(r.twin, slice(0, 1))}, "a comparison needs at least 2"),
        (lambda r: {"physical": sliced(r.physical, slice(0, 0))}, "a comparison needs at least 2"),
        (lambda r: {"joint_names": JOINTS[:5]}, "has 6 joints, expected 5"),
    ],
)
def test_recording_that_cannot_be_compared_is_refused(change, words):
    recording = run(duration=1.0)
    with pytest.raises(ConstructionTwinError, match=words):
        dataclasses.replace(recording, **change(recording))


def test_streams_that_do_not_meet_are_refused():
    recording = run(duration=1.0, plans=False)
    late = Stream(
        recording.physical.stamps + 60 * NANOSECONDS, recording.physical.positions, recording.physical.received
    )
    with pytest.raises(ConstructionTwinError, match="twin and physical samples do not overlap in time"):
        evaluate(dataclasses.replace(recording, physical=late))
    with pytest.raises(ConstructionTwinError, match="no physical sample of that time"):
        evaluate(dataclasses.replace(run(duration=1.0), physical=late, feedback=None))


def test_stopped_clock_is_refused():
    recording = run(duration=1.0)
    frozen = Stream(np.full_like(recording.twin.stamps, BASE), recording.twin.positions, recording.twin.received)
    with pytest.raises(ConstructionTwinError, match="the twin's stamps do not increase"):
        evaluate(dataclasses.replace(recording, twin=frozen, feedback=None))


def test_damaged_values_are_refused():
    twin = twin_stream(1.0)
    twin.positions[7, 2] = np.nan
    with pytest.raises(ConstructionTwinError, match="a recorded joint position is not a finite number"):
        Stream(twin.stamps, twin.positions, twin.received)
    with pytest.raises(ConstructionTwinError, match="stamps, positions, received of"):
        Stream(twin.stamps[:-1], twin.positions, twin.received)
