"""`make soak ARGS=faults`: its judge, with a leg that keeps every promise and legs that break each; and what it reads and steps."""

from __future__ import annotations

import importlib
import itertools
import os
import random
import struct
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import soak_judge
import soak_witness
from processes import ROOT, wait_until
from soak_judge import (
    BLEND,
    LIFETIME,
    MAX_GROWTH,
    PROMISES,
    Finding,
    Leg,
    Permission,
    Play,
    Refusal,
    Samples,
    Stop,
    Stretch,
    Trace,
    judge,
    memory_does_not_grow,
    motions,
    never_exercised,
    table,
    total,
)
from soak_witness import RecordEye
from soak_world import SoakWorld

from construction_twin.gateway.states import State
from construction_twin.gateway.trace import TraceWriter

CYCLE, LENGTH = 0.004, 40.0
#: When the good leg's motions begin and end, and by how much the joint moves [s], [rad].
FIRST, SECOND = (5.0, 8.0, 0.4), (20.0, 23.0, -0.4)
LAG = 0.1


def path(*moves: tuple[float, float, float]) -> Samples:
    """Return the poses of two joints; the first one moves smoothly from `begin` to `end` by `travel`, for each of the moves."""
    times = np.arange(0.0, LENGTH, CYCLE)
    joint = np.zeros(len(times))
    for begin, end, travel in moves:
        share = np.clip((times - begin) / (end - begin), 0.0, 1.0)
        joint += travel * (share**2) * (3.0 - 2.0 * share)
    return Samples(times, np.arange(len(times)), np.column_stack([joint, np.zeros(len(times))]))


def later(samples: Samples, seconds: float) -> Samples:
    """Return what lags behind by some seconds."""
    cycles = round(seconds / CYCLE)
    behind = np.vstack([np.repeat(samples.positions[:1], cycles, axis=0), samples.positions[:-cycles]])
    return replace(samples, positions=behind)


TWIN = path(FIRST, SECOND)
GOOD = Leg(
    arm=later(TWIN, LAG),
    twin=TWIN,
    velocity=(2.0, 2.0),
    braking=0.8,
    threshold=(0.01, 0.01),
    fault=Stretch(7.0, 15.0, "stop"),
    end=LENGTH,
    permissions=(Permission("one", 4.8, 4.9), Permission("two", 19.9, 19.95)),
    plays=(Play("one", 5.0, 8.0), Play("two", 20.0, 23.0)),
    stops=(Stop("stop", 7.4, 15.0, at_gateway=True),),
    armed=(Stretch(0.0, 7.5), Stretch(15.2, LENGTH)),
    in_sync=(Stretch(0.0, 7.5), Stretch(15.2, LENGTH)),
    holds=(Stretch(7.5, 15.2, "WAITING"),),
    trace=Trace(10_000, 3),
    records=4,
    refusals=(Refusal("a late approval", True, "executor refused too_old"),),
    nodes_before={"executor": 1, "broker": 2},
    nodes_after={"executor": 1, "broker": 7},
    killed=frozenset({"broker"}),
    retained_before=frozenset({"status"}),
    retained_after=frozenset({"status", "plan"}),
    log_lines=10,
)
#: The pose without the first motion, and with a jump in it.
NO_MOTION = replace(GOOD, arm=path(SECOND), permissions=GOOD.permissions[1:])


def jumping() -> Samples:
    positions = GOOD.arm.positions.copy()
    positions[6000:] += 0.02
    return replace(GOOD.arm, positions=positions)


BROKEN: dict[str, list[Leg]] = {
    "no approval, no motion": [
        replace(GOOD, permissions=GOOD.permissions[:1]),
        # too old, and one approval for two motions
        replace(GOOD, permissions=(GOOD.permissions[0], Permission("two", 20.0 - LIFETIME - 1.0, 17.0)), plays=()),
        replace(GOOD, permissions=(Permission("one", 4.8, 4.9),), plays=GOOD.plays[:1]),
        # the approval comes after the motion
        replace(GOOD, permissions=(GOOD.permissions[0], Permission("two", 20.5, 20.6)), plays=()),
    ],
    "recorded before motion": [
        replace(GOOD, permissions=(Permission("one", 4.8, None), GOOD.permissions[1])),
        replace(GOOD, permissions=(Permission("one", 4.8, 5.9), GOOD.permissions[1])),
    ],
    "a stop brakes and stands": [
        # it moves on, it moves again, it is armed by itself
        replace(GOOD, stops=(Stop("stop", 5.3, 15.0),)),
        replace(GOOD, stops=(Stop("stop", 9.0, 30.0),)),
        replace(GOOD, armed=(Stretch(0.0, 7.5), Stretch(12.0, LENGTH))),
    ],
    "corrections within limits": [replace(GOOD, trace=Trace(10, 0, ("A1 velocity",)))],
    "no step": [replace(GOOD, arm=jumping())],
    "twin and arm agree": [
        replace(GOOD, arm=later(TWIN, 1.5)),
        replace(GOOD, arm=replace(GOOD.arm, positions=GOOD.arm.positions + 0.02)),
        # more behind than was said, and said of another time
        replace(GOOD, arm=later(TWIN, 1.5), trail=((0.0, 0.0), (6.0, 0.5), (20.0, 0.0), (30.0, 0.0))),
    ],
    "no hold without a cause": [
        replace(GOOD, holds=(Stretch(30.0, 31.0, "HOLDING"),)),
        replace(GOOD, holds=(Stretch(5.5, 6.0, "STALE"),)),
    ],
    "record chain intact": [replace(GOOD, chain="line 3 was changed")],
    "refused and counted": [
        replace(GOOD, refusals=(Refusal("a late approval", False, "executor refused too_old"),)),
        replace(GOOD, refusals=(Refusal("a late approval", True, ""),)),
    ],
    "programs live or come back": [
        replace(GOOD, nodes_after={"executor": 3, "broker": 7}),
        replace(GOOD, nodes_after={"executor": 1}),
        replace(GOOD, nodes_after={"executor": 1, "broker": 2}),
    ],
    "retained topics are back": [replace(GOOD, retained_after=frozenset({"plan"}))],
    "no unannounced error": [replace(GOOD, log=("executor.log: Traceback",))],
    "a person brings it back": [replace(GOOD, failed="not back after 90 s")],
}


def test_a_good_leg_keeps_every_promise_and_puts_each_to_the_test():
    findings = judge(GOOD)
    assert {name: found.violations for name, found in findings.items() if found.violations} == {}
    assert never_exercised(findings) == []


def test_each_promise_has_a_leg_that_breaks_it():
    assert set(BROKEN) == set(PROMISES)


@pytest.mark.parametrize(("promise", "leg"), [(name, leg) for name, legs in BROKEN.items() for leg in legs])
def test_what_breaks_a_promise_is_found_under_its_name(promise, leg):
    assert judge(leg)[promise].violations


def test_an_arm_that_trails_by_what_was_put_off_agrees_with_the_twin():
    said = ((0.0, 0.0), (5.5, 1.4), (9.0, 1.4), (19.0, 1.4), (26.0, 0.0))
    assert judge(replace(GOOD, arm=later(TWIN, 1.5), trail=said))["twin and arm agree"].violations == ()


def test_a_trail_counts_while_it_is_told():
    leg = replace(GOOD, trail=((0.0, 0.1), (6.0, 0.4), (6.5, 0.1)))
    assert [round(leg.follows(time) - soak_judge.FOLLOWS, 3) for time in (5.0, 6.2, 8.0)] == [0.1, 0.4, 0.1]


def test_where_the_twin_was_not_heard_nothing_is_said_of_its_agreement():
    heard = (TWIN.times < 5.6) | (TWIN.times > 6.4)
    deaf = replace(TWIN, times=TWIN.times[heard], numbers=TWIN.numbers[heard], positions=TWIN.positions[heard])
    found = judge(replace(GOOD, twin=deaf))["twin and arm agree"]
    assert found.violations == ()
    assert 8 <= found.disturbed <= 20


def test_a_motion_is_what_lies_between_rests():
    first, second = motions(GOOD.arm)
    assert first.begin == pytest.approx(FIRST[0] + LAG, abs=0.01)
    assert second.end == pytest.approx(SECOND[1] + LAG, abs=0.01)
    assert (first.travel, second.travel) == (pytest.approx(0.4), pytest.approx(0.4))
    assert motions(path()) == []


def test_the_remainder_of_a_start_tolerance_needs_no_approval():
    leg = replace(GOOD, arm=path((30.0, 30.5, BLEND / 2)), twin=path(), permissions=(), plays=(), stops=())
    assert judge(leg)["no approval, no motion"] == Finding(0)


def test_a_plan_goes_on_after_replies_were_lost_but_not_after_a_pause_without_a_resume():
    # the arm stands for a second in mid-motion
    moves = (5.0, 6.0, 0.2), (7.0, 8.0, 0.2), SECOND
    played = replace(GOOD, arm=path(*moves), twin=path(*moves), stops=())
    assert not judge(played)["no approval, no motion"].violations
    paused = replace(played, plays=(Play("one", 5.0, 6.1), GOOD.plays[1]), stops=(Stop("pause", 5.5, 30.0),))
    assert judge(paused)["no approval, no motion"].violations
    resumed = replace(paused, permissions=(*GOOD.permissions, Permission("one", 6.9, resume=True)))
    assert not judge(resumed)["no approval, no motion"].violations


def test_what_a_pause_of_the_machine_explains_is_counted_and_is_no_violation():
    pause = (Stretch(29.5, 29.6),)
    held = judge(replace(GOOD, holds=(Stretch(30.0, 31.0, "HOLDING"),), pauses=pause))["no hold without a cause"]
    assert (held.violations, held.disturbed) == ((), 1)
    short = judge(replace(GOOD, holds=(Stretch(30.0, 31.0),), pauses=(Stretch(29.5, 29.505),)))
    assert short["no hold without a cause"].violations


def test_what_was_not_put_to_the_test_is_named():
    nothing = replace(NO_MOTION, stops=(), refusals=())
    assert never_exercised(judge(nothing)) == ["a stop brakes and stands", "refused and counted"]
    short = replace(GOOD, stops=(Stop("stop", 14.0, 15.0),))
    assert "a stop brakes and stands" in never_exercised(judge(short))


def test_memory_that_grows_is_told_by_name_and_warming_up_is_not_growth():
    steady, grows = [10.0] + [50.0] * 9, [50.0] * 5 + [51.0 + MAX_GROWTH] * 5
    assert memory_does_not_grow({"a": steady, "b": steady}) == Finding(2)
    found = memory_does_not_grow({"a": steady, "b": grows})
    assert len(found.violations) == 1 and found.violations[0].startswith("b grew from 50.0 to 55.0 MB")
    assert memory_does_not_grow({"a": [1.0, 90.0]}) == Finding(0)


def test_sums_and_table_tell_each_promise_once():
    sums = total([judge(GOOD), judge(BROKEN["no step"][0])])
    assert sums["no step"].exercised == 2 * (len(GOOD.arm.times) - 1)
    rows = table(sums).splitlines()
    assert len(rows) == 1 + len(PROMISES)
    assert any(row.split()[-1] == "1" and row.startswith("no step ") for row in rows)


def test_the_clock_of_some_programs_is_stepped_while_they_run(tmp_path):
    library, clock = tmp_path / "wall_clock.so", tmp_path / "clock"
    source = ROOT / "test" / "support" / "wall_clock.c"
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    clock.write_bytes(struct.pack("<qq", 0, 0))
    look = "import sys, time\nfor line in sys.stdin: print(time.time(), time.monotonic(), flush=True)"
    given = os.environ | {
        "LD_PRELOAD": str(library),
        "WALL_CLOCK_FILE": str(clock),
        "WALL_CLOCK_CELL": "mosquitto:the_gateway",
    }
    programs = [
        subprocess.Popen([sys.executable, "-c", look, name], stdin=-1, stdout=-1, text=True, bufsize=1, env=given)
        for name in ("executor", "the_gateway")
    ]

    def differences() -> list[float]:
        """Wall clock less monotonic clock [s]."""
        found = []
        for program in programs:
            program.stdin.write("\n")
            wall, monotonic = map(float, program.stdout.readline().split())
            found.append(wall - monotonic)
        return found

    before = differences()
    for steps in ((-7.25, 0.0), (9.5, -3.5), (0.0, 0.0)):
        with open(clock, "r+b") as file:
            file.write(struct.pack("<qq", *(round(step * 1e9) for step in steps)))
        moved = [now - then for now, then in zip(differences(), before)]
        assert moved == pytest.approx(steps, abs=0.05)
    for program in programs:
        program.communicate()
        assert program.returncode == 0


@pytest.fixture(scope="module")
def script():
    with pytest.MonkeyPatch.context() as patch:
        for folder in ("scripts", "benchmarks", "test/integration"):
            patch.syspath_prepend(str(ROOT / folder))
        yield importlib.import_module("soak_faults")


class Traced:
    """A world of which only the length of the trace is asked."""

    traced = 0


def test_each_fault_comes_once_before_any_comes_again_and_in_the_order_of_the_seed(script):
    def orders(seed: int) -> list[str]:
        return [
            fault.name
            for fault in itertools.islice(
                script.drawn(script.FAULTS, random.Random(seed), Traced()), 2 * len(script.FAULTS)
            )
        ]

    first, second = orders(1)[: len(script.FAULTS)], orders(1)[len(script.FAULTS) :]
    assert sorted(first) == sorted(second) == sorted(fault.name for fault in script.FAULTS)
    assert first != second and orders(1) == orders(1) != orders(2)


def test_a_trace_that_is_nearly_full_is_begun_anew_first(script):
    world = Traced()
    faults = script.drawn(script.FAULTS, random.Random(1), world)
    world.traced = script.MOST_TRACED + 1
    assert next(faults) is script.NEW_TRACE
    world.traced = 0
    assert len({fault.name for fault in itertools.islice(faults, len(script.FAULTS))}) == len(script.FAULTS)


def test_what_a_program_said_before_it_ended_is_said_no_more(monkeypatch):
    clock = iter([1.0, 1.1, 1.2, 4.0, 4.1])
    monkeypatch.setattr(soak_witness.rospy, "Subscriber", lambda *_: None)
    monkeypatch.setattr(soak_witness.time, "monotonic", lambda: next(clock))
    ear = soak_witness.StateEar("sync", object, lapses=0.3)
    for state in ("in_sync", "in_sync", "in_sync", "in_sync", "holding"):
        ear.on_state(SimpleNamespace(state=state, text=state, reason=""))
    stretches = [(stretch.begin, stretch.end, state) for stretch, state in ear.take(5.0)]
    assert stretches == [(1.0, 1.2, "in_sync"), (1.2, 4.0, None), (4.0, 4.1, "in_sync"), (4.1, 5.0, "holding")]


def test_a_log_is_read_once_in_whole_lines_and_a_traceback_with_its_end(tmp_path):
    world = SoakWorld(tmp_path)
    log = tmp_path / "bringup.log"
    log.write_text("started\n\x1b[31m[ERROR] one\x1b[0m\n[ERROR] one\nhalf a li")
    assert world.new_log_lines() == (3, ["bringup.log: [ERROR] one"])
    with open(log, "a") as file:
        file.write(
            "ne ERROR\nTraceback (most recent call last):\n  File x\n2026-11-25 gateway INFO following\n    y\nValueError: no\n"
        )
    count, bad = world.new_log_lines()
    assert count == 6
    assert bad[0] == "bringup.log: half a line ERROR"
    assert bad[1].startswith("bringup.log: Traceback") and bad[1].endswith("ValueError: no")
    assert world.new_log_lines() == (0, [])


def test_traces_go_on_where_they_ended_with_one_entry_in_common(tmp_path):
    world = SoakWorld(tmp_path)
    writer = TraceWriter(str(world.trace_file), 1, cycles=100)
    for ipoc in range(10):
        writer.record(4 * ipoc, 1, State.FOLLOWING, 0, (0.1 * ipoc,))
    (run,) = world.traces()
    assert [entry.ipoc for entry in run] == [4 * k for k in range(10)]
    for ipoc in range(10, 13):
        writer.record(4 * ipoc, 1, State.FOLLOWING, 0, (0.1 * ipoc,))
    (run,) = world.traces()
    assert [entry.ipoc for entry in run] == [36, 40, 44, 48]
    assert world.traced == 13


def test_approvals_are_seen_in_the_record_when_their_line_is_whole(tmp_path):
    path = tmp_path / "reviews.jsonl"
    eye = RecordEye(path)
    try:
        with open(path, "w", buffering=1) as file:
            file.write('{"verdict": "rejected", "plan": "a"}\n{"verdict": "approved", "plan": "b"}\n{"verdict": "appr')
            file.flush()
            wait_until(lambda: eye.lines == 2, what="two lines")
            assert set(eye.approved) == {"b"}
            file.write('oved", "plan": "c"}\n')
            wait_until(lambda: set(eye.approved) == {"b", "c"}, what="the third")
        assert eye.approved["c"] > eye.approved["b"]
    finally:
        eye.close()
