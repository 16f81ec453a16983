"""The ledger: killed after any line, or in the middle of one, it comes back with what is true."""

from __future__ import annotations

import json
from itertools import count
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.work.ledger import Ledger, LedgerError, initial_states, read_entries
from construction_twin.extensions.work.task_memory import (
    CHANGES,
    PLANNABLE,
    ROWS,
    SETTLED,
    TABLE,
    UNDER_WAY,
    Entry,
    NotNow,
    TaskEvent,
    TaskMemory,
    TaskState,
)

MODEL = "a" * 64
AFTER = {"plate": (), "stud": ("plate",), "board": ("plate", "stud")}
HELD_AS = (0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0)
STANDS = (1.0, 2.0, 0.5, 0.0, 0.0, 0.0, 1.0)
#: Every line of a task that goes well, with the state that it leaves.
STEPS = (
    (Entry("offered", "plate", "E1", offer="o1", grip="top", pose=HELD_AS), TaskState.PLANNED),
    (Entry("planned", "plate", "E1", offer="o1", plan="p1"), TaskState.PLANNED),
    (Entry("begun", "plate", "E1", plan="p1"), TaskState.WORKING),
    (Entry("gripping", "plate", "E1", plan="p1"), TaskState.GRIPPING),
    (Entry("gripped", "plate", "E1", plan="p1"), TaskState.CARRYING),
    (Entry("releasing", "plate", "E1", plan="p1"), TaskState.RELEASING),
    (Entry("released", "plate", "E1", plan="p1", pose=STANDS), TaskState.RETREATING),
    (Entry("finished", "plate", "E1", plan="p1"), TaskState.DONE),
)


def ledger(path: Path, after=AFTER, model: str = MODEL, placing=None) -> Ledger:
    numbers = count(1_700_000_000_000_000_000, 1_000_000)
    return Ledger(path, after, model, lambda: next(numbers), "/cell.yaml", placing or {"E1": "plate", "E2": "stud"})


def test_every_line_is_replayed_to_the_state_it_left(tmp_path):
    path = tmp_path / "ledger.jsonl"
    first = ledger(path)
    for entry, state in STEPS:
        first.add(entry)
        first.close()
        first = ledger(path)
        assert first.states.tasks["plate"].state is state
    memory = first.states.tasks["plate"]
    assert memory.placed and not memory.in_grip and memory.base_T_element == STANDS
    assert first.states.in_state(TaskState.READY) == ("stud",)
    assert len(path.read_text().splitlines()) == first.lines == len(STEPS) + 1


def test_a_kill_inside_any_line_leaves_the_lines_before_it(tmp_path):
    whole = tmp_path / "whole.jsonl"
    first = ledger(whole)
    states = [TaskState.READY]
    for entry, state in STEPS:
        first.add(entry)
        states.append(state)
    content = whole.read_bytes()
    ends = [number for number, byte in enumerate(content) if byte == ord("\n")]
    for cut in sorted(
        {0, 1, *(end + shift for end in ends for shift in (-1, 0, 1, 7)), len(content)} - {len(content) + 6}
    ):
        path = tmp_path / "cut.jsonl"
        path.write_bytes(content[:cut])
        again = ledger(path)
        lines = content[:cut].count(b"\n")
        assert again.states.tasks["plate"].state is states[max(lines - 1, 0)]
        torn = cut > 0 and content[cut - 1 : cut] != b"\n"
        assert [entry.event for entry in read_entries(path)].count("mended") == torn
        again.add(Entry("accept_schedule", schedule="s", person="eva"))
        again.close()
        last = ledger(path)
        last.close()
        assert last.states.accepted == "s"


def test_what_was_done_may_not_be_offered_again(tmp_path):
    book = ledger(tmp_path / "ledger.jsonl")
    for entry, _ in STEPS:
        book.add(entry)
    lines = book.lines
    with pytest.raises(NotNow, match="plate is done"):
        book.add(Entry("offered", "plate", "E1", offer="o2"))
    assert book.lines == lines


@pytest.mark.parametrize(
    ("answer", "state", "in_grip", "placed"),
    [
        ("in_stock", TaskState.READY, False, False),
        ("in_grip", TaskState.CARRIED, True, False),
        ("placed", TaskState.DONE, False, True),
        ("gone", TaskState.HELD, False, False),
    ],
)
def test_a_person_answers(tmp_path, answer, state, in_grip, placed):
    book = ledger(tmp_path / "ledger.jsonl")
    for entry, _ in STEPS[:5]:
        book.add(entry)
    book.add(Entry("stopped", "plate", "E1", reason="held"))
    memory = book.states.tasks["plate"]
    assert memory.state is TaskState.ASKS and answer in memory.possible_answers()
    book.add(Entry("answered", "plate", "E1", answer=answer, person="eva"))
    memory = book.states.tasks["plate"]
    assert (memory.state, memory.in_grip, memory.placed) == (state, in_grip, placed)
    if state is TaskState.CARRIED:
        assert memory.tool0_T_element == HELD_AS
        book.add(Entry("offered", "plate", "E1", offer="o2"))
        book.add(Entry("dropped", "plate", "E1"))
        assert book.states.tasks["plate"].state is TaskState.CARRIED
        book.add(Entry("offered", "plate", "E1", offer="o3"))
        book.add(Entry("begun", "plate", "E1", plan="p3"))
        assert book.states.tasks["plate"].state is TaskState.CARRYING


def test_what_was_never_held_cannot_have_been_placed(tmp_path):
    book = ledger(tmp_path / "ledger.jsonl")
    for entry, _ in STEPS[:4]:
        book.add(entry)
    book.add(Entry("unknown", "plate", "E1"))
    assert book.states.tasks["plate"].possible_answers() == ("in_stock", "in_grip", "gone")
    for wrong in ("placed", "perhaps", ""):
        with pytest.raises(NotNow):
            book.add(Entry("answered", "plate", "E1", answer=wrong))


def test_skipped_tasks_free_others_and_redone_ones_block_them(tmp_path):
    book = ledger(tmp_path / "ledger.jsonl")
    assert book.states.missing("board") == ("plate", "stud")
    book.add(Entry("skipped", "plate", person="eva"))
    book.add(Entry("skipped", "stud", person="eva"))
    assert book.states.in_state(TaskState.READY) == ("board",)
    book.add(Entry("redone", "stud", person="eva"))
    assert book.states.in_state(TaskState.WAITING) == ("board",)
    book.add(Entry("measured", "plate", pose=STANDS, person="eva"))
    assert book.states.tasks["plate"].placed and book.states.tasks["plate"].measured_by == "eva"


def test_a_task_that_others_stand_on_is_named(tmp_path):
    book = ledger(tmp_path / "ledger.jsonl")
    for entry, _ in STEPS:
        book.add(entry)
    assert book.states.followers("plate") == ()
    book.add(Entry("offered", "stud", "E2", offer="o2"))
    assert book.states.followers("plate") == ("stud",)


def test_a_changed_schedule_does_not_undo_what_was_done(tmp_path):
    path = tmp_path / "ledger.jsonl"
    book = ledger(path)
    for entry, _ in STEPS:
        book.add(entry)
    book.close()
    again = ledger(path, {"stud": (), "plate": ("stud",)})
    assert again.states.tasks["plate"].state is TaskState.DONE
    again.close()
    gone = ledger(path, {"stud": ()}, placing={"E2": "stud"})
    assert gone.states.former["plate"].placed and gone.states.asking == ()


@pytest.mark.parametrize("number", range(len(STEPS)))
@pytest.mark.parametrize("answer", ["placed", "gone"])
def test_a_changed_model_asks_about_everything_that_was_touched(tmp_path, number, answer):
    path = tmp_path / "ledger.jsonl"
    before = ledger(path)
    for entry, _ in STEPS[: number + 1]:
        before.add(entry)
    before.close()
    again = ledger(path, model="b" * 64)
    memory = again.states.tasks["plate"]
    assert memory.state is TaskState.ASKS and again.states.model == "b" * 64
    assert again.states.in_state(*PLANNABLE) == ()
    lines = again.lines
    again.close()
    once_more = ledger(path, model="b" * 64)
    assert once_more.lines == lines, "it asks once for each change"
    if answer in once_more.states.tasks["plate"].possible_answers():
        once_more.add(Entry("answered", "plate", "E1", answer=answer, person="eva"))
    if number >= 6:
        pose = once_more.states.tasks["plate"].base_T_element
        assert pose == (STANDS if answer == "placed" else ())


def test_an_element_that_another_task_places_now_is_asked_about(tmp_path):
    path = tmp_path / "ledger.jsonl"
    before = ledger(path)
    for entry, _ in STEPS:
        before.add(entry)
    before.close()
    again = ledger(path, {"new": ()}, "b" * 64, {"E1": "new"})
    memory = again.states.tasks["new"]
    assert memory.state is TaskState.ASKS and memory.possible_answers() == ("in_stock", "placed", "gone")
    assert again.states.former == {}
    again.add(Entry("answered", "new", "E1", answer="placed", person="eva"))
    memory = again.states.tasks["new"]
    assert memory.state is TaskState.DONE and memory.base_T_element == STANDS


def test_a_file_that_is_no_ledger_is_refused(tmp_path):
    path = tmp_path / "ledger.jsonl"
    ledger(path).close()
    path.write_text(path.read_text().replace("opened", "mended"))
    with pytest.raises(LedgerError, match="this is no ledger"):
        ledger(path)


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["event", "pose", "task", "x"]), inner),
    max_leaves=6,
)


@given(JSON)
def test_strange_lines_end_in_a_sentence(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("strange") / "ledger.jsonl"
    path.write_text(json.dumps(content) + "\n")
    with pytest.raises((LedgerError, ConfigurationError), match="expected|found|line"):
        ledger(path)


# -- the table


def test_the_table_uses_what_it_declares():
    assert {row.change for row in TABLE} == set(CHANGES)
    assert {row.event for row in TABLE} == set(TaskEvent)
    assert {row.target for row in TABLE} - {None} == set(TaskState)
    assert len(set(TABLE)) == len(TABLE)


def test_a_placed_element_is_planned_again_only_when_a_person_says_so():
    ways = {row.event for row in TABLE if row.state is TaskState.DONE and row.target in PLANNABLE}
    assert ways == {TaskEvent.REDONE}
    assert {
        row.event for row in TABLE if row.state is TaskState.RETREATING and row.target is not TaskState.DONE
    } == set()


def test_no_state_under_way_survives_not_knowing():
    for state in (*UNDER_WAY, TaskState.PLANNED):
        assert {row.target for row in ROWS[state, TaskEvent.UNKNOWN]} <= {TaskState.ASKS, *SETTLED}


EVENTS = st.lists(
    st.tuples(st.sampled_from(list(TaskEvent)), st.sampled_from(["in_stock", "in_grip", "placed", "gone"])), max_size=40
)


@given(EVENTS)
def test_an_element_is_in_one_place_only(events):
    memory = TaskMemory("plate")
    for event, answer in events:
        entry = Entry(event.value, "plate", answer=answer, plan="p", offer="o", pose=STANDS)
        if memory.accepts(entry):
            memory = memory.with_entry(entry)
        else:
            with pytest.raises(NotNow):
                memory.with_entry(entry)
        assert memory.in_grip + memory.placed + memory.gone <= 1
        if memory.state in (TaskState.CARRIED, TaskState.CARRYING, TaskState.RELEASING):
            assert memory.in_grip
        if memory.state in (TaskState.READY, TaskState.WAITING):
            assert not (memory.in_grip or memory.placed or memory.gone)


@given(
    st.lists(
        st.tuples(st.sampled_from(list(AFTER)), st.sampled_from([*TaskEvent]), st.sampled_from(["in_stock", "placed"])),
        max_size=60,
    )
)
def test_a_task_waits_exactly_while_another_one_before_it_is_not_settled(events):
    book = initial_states(AFTER, {})
    for task, event, answer in events:
        entry = Entry(event.value, task, answer=answer)
        if event not in (TaskEvent.FREED, TaskEvent.BLOCKED) and book.tasks[task].accepts(entry):
            book = book.with_entry(entry)
        assert all(bool(book.missing(name)) for name in book.in_state(TaskState.WAITING))
        assert not any(book.missing(name) for name in book.in_state(TaskState.READY))
