"""From a run of the whole chain to its servos: what a bag of it holds is enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chain_samples import REACH, ROBOT, make_chain, make_plan, play_to_the_end

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.evaluation.recording import FeedbackStream, StateChange
from construction_twin.extensions.physics.commands.identify import cycle_of, recorded_motions
from construction_twin.extensions.physics.identification import identify


@pytest.fixture(scope="module")
def run():
    chain = make_chain(3, "realistic")
    chain.run_for(0.5)
    for goal in (REACH, ROBOT.home, tuple(0.5 * (np.array(REACH) + np.array(ROBOT.home)))):
        play_to_the_end(chain, make_plan(chain, goal))
    recording = chain.recording()
    return replace(recording, command=recording.twin)


def test_the_mocks_servo_is_found_from_what_a_bag_holds(run):
    assert cycle_of(run) == CYCLE_NS
    drives = recorded_motions(run, CYCLE_NS)
    assert sum(len(drive.targets) for drive in drives) > 1000
    for joint in identify(run.joint_names, drives, CYCLE_NS):
        assert joint.servo.lag(CYCLE) == pytest.approx(2 * 0.8 / 60.0 - CYCLE / 2, abs=1e-4)
        assert joint.residual_max < 2e-5 and joint.residual_rms < 1e-5


def test_states_that_are_missing_end_a_stretch_and_the_next_begins_at_rest(run):
    feedback = run.feedback
    kept = np.ones(len(feedback), bool)
    moving = int(np.argmax(np.abs(np.diff(feedback.positions[:, 0]))))
    kept[moving] = False
    parts = {
        name: getattr(feedback, name)[kept] for name in ("stamps", "positions", "received", "seq", "command_stamps")
    }
    whole = recorded_motions(run, CYCLE_NS)
    drives = recorded_motions(replace(run, feedback=FeedbackStream(**parts)), CYCLE_NS)
    assert len(drives) == len(whole) + 1
    assert all((drive.targets[0] == drive.targets[1]).all() for drive in drives)


def test_rows_at_a_closed_gate_are_not_judged(run):
    at = int(run.feedback.stamps[len(run.feedback) // 2])
    closed = (StateChange(0, "gate", "IN_SYNC", ""), StateChange(at, "gate", "HOLDING", ""))
    counts = [drive.counts.sum() for drive in recorded_motions(run, CYCLE_NS)]
    fewer = [drive.counts.sum() for drive in recorded_motions(replace(run, changes=closed), CYCLE_NS)]
    assert sum(fewer) < 0.6 * sum(counts)


def test_a_recording_without_commands_or_stamps_is_refused(run):
    for lacking in (replace(run, command=None), replace(run, feedback=None)):
        with pytest.raises(ConstructionTwinError):
            identify(run.joint_names, recorded_motions(lacking, CYCLE_NS), CYCLE_NS)
    none = replace(run.feedback, command_stamps=np.zeros_like(run.feedback.command_stamps))
    with pytest.raises(ConstructionTwinError):
        cycle_of(replace(run, feedback=none))
