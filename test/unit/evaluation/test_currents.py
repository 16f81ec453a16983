"""Motor currents against a reference run of the same plan: aligned by the plan, whatever the pace."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plan_samples import make_plan
from rich.console import Console

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.evaluation.current_figure import current_figure
from construction_twin.evaluation.current_tables import currents_csv, render_currents
from construction_twin.evaluation.currents import compare_currents, elapsed_along, runs_of, same_plan, summary_of
from construction_twin.evaluation.recording import CurrentStream, PlayedPlan, Recording, Stream
from construction_twin.robot.trajectory import Trajectory

JOINTS = ("track", "joint_a1", "joint_a2")
BASE = 1_790_000_000_000_000_000
#: There and back over the same path, with a rest of half a second in between.
TIMES = np.array([0.0, 1.0, 2.0, 2.5, 3.5, 4.5])
POINTS = np.array(
    [[0.0, 0.0, -1.0], [0.5, 0.4, -0.9], [1.0, 1.0, 0.2], [1.0, 1.0, 0.2], [0.5, 0.4, -0.9], [0.0, 0.0, -1.0]]
)
SPEEDS = np.array([[0.0] * 3, [0.6, 0.7, 0.5], [0.0] * 3, [0.0] * 3, [-0.6, -0.7, -0.5], [0.0] * 3])
TRAJECTORY = Trajectory(JOINTS, TIMES, POINTS, SPEEDS, np.zeros_like(SPEEDS))
PLAN = make_plan(TRAJECTORY, "p1")
#: Fraction of the planned speed per cycle of a ramp.
RAMP = 0.04


def currents_at(times):
    """Return what each axis takes where it is on the plan, shape (m, 3): the same while it rests; the track's is not told."""
    times = times - np.clip(times - 2.0, 0.0, 0.5)
    return np.stack([np.full_like(times, np.nan), 20.0 + 8.0 * np.sin(times), -30.0 * np.cos(0.7 * times)], axis=1)


def rates_of(*stretches, rest=40):
    """Return the rate of each cycle: from rest over stretches of rate and length [cycles] to the end of the plan at full speed."""
    rates, now = [0.0] * rest, 0.0
    for rate, cycles in (*stretches, (1.0, 2000)):
        for _ in range(cycles):
            now += float(np.clip(rate - now, -RAMP, RAMP))
            rates.append(now)
    return np.array(rates)


def recorded(*stretches, phase=0.3, currents=currents_at, plan=PLAN, unsteady=(), start_offset=0):
    """Return a run of the plan with a rate that varies, and the true time of the plan of each command."""
    rates = rates_of(*stretches)
    elapsed = np.minimum(np.cumsum(rates) * CYCLE, plan.trajectory.duration)
    last = int(np.argmax(elapsed >= plan.trajectory.duration)) + 100
    elapsed = elapsed[:last]
    stamps = BASE + start_offset + np.arange(last, dtype=np.int64) * CYCLE_NS
    positions = plan.trajectory.sample_many(elapsed)[0]
    setpoints = Stream(stamps, positions, stamps)
    # as the joint string carries it
    command = Stream(stamps, np.radians(np.round(np.degrees(positions), 3)), stamps)
    told = stamps[1:] + round(phase * CYCLE_NS)
    values = currents(np.interp(told, stamps, elapsed))
    names = told.copy()
    names[list(unsteady)] = 0
    begins = int(stamps[np.flatnonzero(rates[:last] > 0.0)[0] - 1])
    run = Recording(
        "/kr120", JOINTS, command, command, command=command, setpoints=setpoints,
        currents=CurrentStream(values, names),
        plans=(PlayedPlan(plan.id, begins, plan.trajectory.duration, "finished"),),
    )  # fmt: skip
    return run, elapsed


def compared(reference, run, plans=(PLAN,), **options):
    return compare_currents(*same_plan(runs_of("ref.bag", reference, plans), runs_of("run.bag", run, plans)), **options)


def axis(comparison, joint):
    return next(each for each in comparison.axes if each.joint == joint)


def test_an_equal_run_differs_by_nothing():
    found = compared(recorded()[0], recorded()[0])
    assert [each.largest for each in found.axes] == [None, 0.0, 0.0]
    assert [each.rms for each in found.axes[1:]] == [0.0, 0.0]
    # all of the plan, with the ramp in which both speed up
    assert found.times[0] < 0.01 and found.times[-1] > TRAJECTORY.duration - 0.01
    assert (found.other_pace, found.no_reference, found.unsteady) == (0, 0, 0)


def test_an_axis_with_a_fifth_more_is_found_where_it_takes_most():
    def more(times):
        return currents_at(times) * [1.0, 1.0, 1.2]

    found = compared(recorded()[0], recorded(phase=0.8, currents=more)[0])
    a1, a2 = axis(found, "joint_a1"), axis(found, "joint_a2")
    assert abs(a1.largest) < 0.01 and found.worst is a2
    # -30 cos(0.7 t) is largest at t = 0, of which the executor's ramp is left out, and at the plan's end, t = 4
    assert a2.time < 0.5 and a2.largest == pytest.approx(-6.0, abs=0.3)
    assert a2.setpoint == round(a2.time / CYCLE) and a2.measured == pytest.approx(1.2 * a2.reference, rel=1e-3)
    assert a2.rms == pytest.approx(0.2 * a2.reference_rms, rel=1e-3)
    assert a2.position == pytest.approx(TRAJECTORY.sample(a2.time)[0][2])


def test_a_difference_is_said_of_the_way_on_which_it_is():
    # there and back are the same poses: only where the arm is on the plan tells them apart
    def on_the_way_back(times):
        return currents_at(times) + np.where((times > 3.6) & (times < 3.7), 9.0, 0.0)[:, None]

    found = compared(recorded()[0], recorded((1.0, 300), (0.0, 200), currents=on_the_way_back)[0])
    assert 3.6 < axis(found, "joint_a1").time < 3.7 and axis(found, "joint_a1").largest == pytest.approx(9.0, abs=0.01)


PAUSES = [
    ((1.0, 300), (0.0, 250)),
    ((0.3, 900),),
    ((1.0, 100), (0.5, 300), (1.0, 100), (0.0, 77)),
    # in the rest in the middle of the plan
    ((1.0, 560), (0.0, 400)),
]


@pytest.mark.parametrize("stretches", PAUSES)
@pytest.mark.parametrize("turned", [False, True])
def test_a_run_with_pauses_and_speed_limits_is_aligned_all_the_same(stretches, turned):
    pair = recorded(phase=0.7)[0], recorded(*stretches)[0]
    found = compared(*(reversed(pair) if turned else pair))
    assert found.other_pace > 50 and found.compared > 150
    # the end, whose last step is no whole one, counts for all of them
    assert found.times[-1] > TRAJECTORY.duration - 0.01
    assert max(abs(each.largest) for each in found.axes[1:]) < 0.02


@settings(deadline=None, max_examples=25)
@given(
    st.lists(st.tuples(st.sampled_from((0.0, 0.2, 0.5, 1.0)), st.integers(1, 300)), max_size=4), st.floats(0.0, 0.99)
)
def test_whatever_the_pace_the_place_on_the_plan_is_found(stretches, phase):
    run, truth = recorded(*stretches, phase=phase)
    found = elapsed_along(TRAJECTORY, run.setpoints)
    assert np.isfinite(found).all()
    # where the arm moves at all, time is known; where it rests there is none to be known
    moving = np.abs(TRAJECTORY.sample_many(truth)[1]).max(axis=1) > 0.05
    assert np.abs(found - truth)[moving].max() < 1e-6
    assert np.abs(TRAJECTORY.sample_many(found)[0] - run.setpoints.positions).max() < 1e-7
    reached = compared(recorded()[0], run, any_pace=True)
    assert max(abs(each.largest) for each in reached.axes[1:]) < 0.05


def test_a_slow_run_is_compared_with_a_fast_one_only_when_that_is_asked_for():
    plan = make_plan(Trajectory(JOINTS, TIMES[:3], POINTS[:3], SPEEDS[:3], np.zeros((3, 3))), "p1")
    slow, fast = recorded((0.5, 5000), plan=plan)[0], recorded(plan=plan)[0]
    with pytest.raises(ConstructionTwinError, match="--any-pace"):
        compared(fast, slow, (plan,))
    assert compared(fast, slow, (plan,), any_pace=True).compared > 900
    # and with one that was as slow without
    assert compared(recorded((0.5, 5000), phase=0.1, plan=plan)[0], slow, (plan,)).compared > 900


def test_what_the_arm_did_not_do_as_commanded_is_counted_and_left_out():
    found = compared(recorded()[0], recorded(unsteady=range(300, 350))[0])
    assert found.unsteady == 50 and found.compared < compared(recorded()[0], recorded()[0]).compared - 49
    # also at its end
    assert compared(recorded()[0], recorded(unsteady=range(1150, 1160))[0]).unsteady == 10
    # what is missing in the reference is not made up between its neighbours
    turned = compared(recorded(unsteady=range(300, 350))[0], recorded()[0])
    assert turned.unsteady == 0 and turned.no_reference >= 49


def other_plan(scale):
    return make_plan(Trajectory(JOINTS, TIMES, scale * POINTS, scale * SPEEDS, np.zeros_like(SPEEDS)), "p2")


def test_another_plan_is_refused_with_both_hashes():
    other = other_plan(0.9)
    with pytest.raises(ConstructionTwinError) as caught:
        compared(recorded()[0], recorded(plan=other)[0], (PLAN, other))
    assert PLAN.hash[:12] in str(caught.value) and other.hash[:12] in str(caught.value)
    assert "ref.bag" in str(caught.value) and "run.bag" in str(caught.value)


def test_the_same_plan_under_another_id_is_the_same_plan():
    again = replace(PLAN, id="p9")
    assert compared(recorded()[0], recorded(plan=again)[0], (PLAN, again)).compared > 900


def test_of_several_executions_the_newest_of_a_plan_in_both_is_taken():
    other, first = other_plan(0.9), recorded()[0]
    second = recorded(plan=other, start_offset=100_000_000_000)[0]

    def joined(stream, *fields):
        return [np.concatenate([getattr(getattr(run, stream), field) for run in (first, second)]) for field in fields]

    command, setpoints = (Stream(*joined(name, "stamps", "positions", "received")) for name in ("command", "setpoints"))
    currents = CurrentStream(*joined("currents", "values", "command_stamps"))
    streams = {"twin": command, "physical": command, "command": command, "setpoints": setpoints, "currents": currents}
    both = replace(first, plans=(*first.plans, *second.plans), **streams)
    runs = runs_of("both.bag", both, (PLAN, other))
    assert [run.plan.id for run in runs] == ["p2", "p1"]
    known, run = same_plan(runs_of("ref.bag", first, (PLAN,)), runs)
    assert run.plan.id == known.plan.id == "p1" and len(run.times) == len(known.times)


RUN = recorded()[0]
VALUES, NAMED = RUN.currents.values, RUN.currents.command_stamps


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"currents": None}, "DEF_MACur"),
        ({"currents": CurrentStream(np.full_like(VALUES, np.nan), NAMED)}, "DEF_MACur"),
        ({"command": None}, "command/joint_states"),
        ({"setpoints": None}, "next/joint_states"),
        ({"plans": ()}, "execution"),
        ({"currents": CurrentStream(VALUES, np.zeros_like(NAMED))}, "execution"),
        # an execution from before the recording, which a latched topic still tells of
        ({"plans": (PlayedPlan("p1", BASE - 10, 4.5, "finished"),)}, "execution"),
    ],
)
def test_a_recording_without_what_it_takes_is_refused_by_its_name(change, said):
    with pytest.raises(ConstructionTwinError, match=said) as caught:
        runs_of("run.bag", replace(RUN, **change), (PLAN,))
    assert str(caught.value).startswith("run.bag ")


def test_a_stopped_run_is_compared_as_far_as_it_came():
    run = recorded()[0]
    half = len(run.setpoints) // 2
    setpoints = Stream(run.setpoints.stamps[:half], run.setpoints.positions[:half], run.setpoints.received[:half])
    found = compared(recorded()[0], replace(run, setpoints=setpoints))
    assert found.times[-1] < 0.6 * TRAJECTORY.duration and axis(found, "joint_a1").largest == 0.0


def test_table_files_and_figure_say_the_same(tmp_path):
    def more(times):
        return currents_at(times) * 1.2

    found = compared(recorded()[0], recorded((1.0, 200), (0.0, 100), currents=more)[0])
    summary = json.loads(json.dumps(summary_of(found), allow_nan=False))
    rows = list(csv.DictReader(io.StringIO(currents_csv(summary))))
    assert [row["joint"] for row in rows] == list(JOINTS) and rows[0]["largest"] == ""
    assert float(rows[2]["largest"]) == axis(found, "joint_a2").largest
    text = io.StringIO()
    render_currents(summary, ("track",), Console(file=text, width=100, highlight=False))
    shown = text.getvalue()
    assert "not told" in shown and f"{axis(found, 'joint_a2').largest:+.2f}" in shown
    assert f"{found.compared} compared" in shown and f"{found.other_pace} at another pace" in shown
    figure = current_figure(found)
    figure.savefig(tmp_path / "currents.png")
    assert (tmp_path / "currents.png").stat().st_size > 10_000
    drawn = figure.axes[4].lines[1].get_ydata()
    # what was left out is a gap
    assert np.isnan(drawn).sum() >= 1 and np.isfinite(drawn).sum() == found.compared
