"""What the executor's reports mean for a task; and a work node that is killed after any line that they lead to."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest
import work_samples

from construction_twin.core.reports import ExecutionReport, ToolReport
from construction_twin.extensions.work.ledger import Ledger
from construction_twin.extensions.work.received_messages import GripReading, Received
from construction_twin.extensions.work.task_memory import PLANNABLE, SETTLED, Entry, TaskMemory, TaskState
from construction_twin.extensions.work.task_recorder import (
    FINISHED,
    PlanActions,
    actions_by_outcome,
    events_after_restart,
    events_of_report,
    plan_actions,
)
from construction_twin.review.record import PlanRecord
from construction_twin.robot.segments import Segment, Switch
from construction_twin.scene.objects import SceneObject
from construction_twin.scene.scene_change import SceneChange

HELD_AS = (0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0)
STANDS = (1.0, 2.0, 0.5, 0.0, 0.0, 0.0, 1.0)
PLAN = PlanActions("p1", grips=1, releases=3)
#: As the work node follows it when the topic `plan` has another one by now.
UNKNOWN_PLAN = PlanActions("p1", grips=-1, releases=-1)
#: States of `Execution.msg`.
IDLE, PLAYING = 1, 2
OPEN, CLOSED, UNKNOWN = GripReading(True, False), GripReading(True, True), GripReading(False, False)


def play(segment: int, at_boundary: bool = False, wants_scene: bool = False, plan_id: str = "p1") -> ExecutionReport:
    return ExecutionReport(
        "PLAYING", "", plan_id, segment=segment, at_boundary=at_boundary, wants_scene=wants_scene, state=PLAYING
    )


def end(outcome: str, segment: int = -1, plan_id: str = "p1") -> ExecutionReport:
    return ExecutionReport("IDLE", "why", plan_id, outcome, segment=segment, state=IDLE)


#: Everything the executor says of a plan of five segments, and what the tool's grip is then.
REPORTS = [
    (play(0), OPEN),
    (play(1), OPEN),
    (play(1, True), CLOSED),
    (play(1, True, True), CLOSED),
    (play(2), CLOSED),
    (play(3), CLOSED),
    (play(3, True), OPEN),
    (play(3, True, True), OPEN),
    (play(4), OPEN),
    (end("finished"), OPEN),
]


class Killed(Exception):
    pass


class Node:
    """What the work node does with reports: write, then act. Ends itself after a number of lines."""

    def __init__(self, path: Path, lines: float = float("inf")):
        numbers = count(1_700_000_000_000_000_000)
        self._left = lines
        self.ledger = Ledger(path, {"stud": ()}, "a" * 64, lambda: next(numbers))

    @property
    def memory(self) -> TaskMemory:
        return self.ledger.states.tasks["stud"]

    def add(self, entry: Entry) -> None:
        if self._left <= 0:
            self.ledger.close()
            raise Killed
        self._left -= 1
        self.ledger.add(entry)

    def offer(self) -> None:
        self.add(Entry("offered", "stud", "E", offer="o1", grip="top", pose=HELD_AS))

    def on_report(self, report: ExecutionReport, grip: GripReading, plan: PlanActions = PLAN) -> None:
        for entry in events_of_report(self.memory, plan, report, grip, STANDS):
            self.add(entry)


def run(node: Node, reports=REPORTS) -> None:
    node.offer()
    node.add(Entry("planned", "stud", "E", offer="o1", plan="p1"))
    for report, grip in reports:
        node.on_report(report, grip)


def test_a_report_that_is_heard_again_adds_nothing(tmp_path):
    once, twice = Node(tmp_path / "once"), Node(tmp_path / "twice")
    run(once)
    run(twice, [each for each in REPORTS for _ in range(2)])
    assert once.ledger.lines == twice.ledger.lines


@pytest.mark.parametrize("gone", range(len(REPORTS)))
def test_a_report_that_was_missed_is_made_up_for(tmp_path, gone):
    node = Node(tmp_path / "ledger")
    run(node, REPORTS[:gone] + REPORTS[gone + 1 :])
    if gone == len(REPORTS) - 1:
        node.on_report(*REPORTS[-1])
    assert node.memory.state is TaskState.DONE and node.memory.base_T_element == STANDS


@pytest.mark.parametrize("lines", range(9))
@pytest.mark.parametrize("later", range(len(REPORTS)))
def test_a_kill_after_any_line_while_the_executor_goes_on(tmp_path, lines, later):
    """It comes back while the executor says something later, and follows on: nothing is asked, nothing forgotten."""
    first = Node(tmp_path / "ledger", lines)
    heard = 0
    try:
        first.offer()
        first.add(Entry("planned", "stud", "E", offer="o1", plan="p1"))
        for heard, (report, grip) in enumerate(REPORTS):
            first.on_report(report, grip)
        first.ledger.close()
    except Killed:
        pass
    if lines < 1:
        return  # it never offered: no plan exists
    again = Node(tmp_path / "ledger")
    for report, grip in REPORTS[max(heard, later) :]:
        again.on_report(report, grip)
    assert again.memory.state is TaskState.DONE
    assert again.memory.placed and again.memory.base_T_element == STANDS


@pytest.mark.parametrize("lines", range(1, 9))
@pytest.mark.parametrize("grip", [OPEN, CLOSED, UNKNOWN])
def test_a_kill_after_any_line_with_everything_else_gone_too(tmp_path, lines, grip):
    first = Node(tmp_path / "ledger", lines)
    try:
        run(first)
        first.ledger.close()
    except Killed:
        pass
    again = Node(tmp_path / "ledger")
    before = again.memory.state
    for entry in events_after_restart(again.memory, PlanRecord("p1", None), grip):
        again.add(entry)
    state = again.memory.state
    if before is TaskState.DONE or before is TaskState.RETREATING:
        assert state is TaskState.DONE
    elif before in (TaskState.CARRYING, TaskState.RELEASING):
        assert state is TaskState.ASKS
    else:
        # it was not carried away from its stock: that is certain only if the grip is surely open
        assert state is (TaskState.READY if grip is OPEN else TaskState.ASKS)
    if state is TaskState.ASKS:
        assert again.memory.question("stud 3").startswith("where is stud 3 now?")
        assert set(again.memory.possible_answers()) >= {"in_stock", "gone"}


@pytest.mark.parametrize("heard", range(len(REPORTS) - 1))
@pytest.mark.parametrize("outcome", ["stopped", "held", "dropped"])
@pytest.mark.parametrize("segment_known", [True, False])
@pytest.mark.parametrize("plan", [PLAN, UNKNOWN_PLAN], ids=["plan", "unknown plan"])
def test_a_stop_after_any_report(tmp_path, heard, outcome, segment_known, plan):
    node = Node(tmp_path / "ledger")
    run(node, REPORTS[: heard + 1])
    before, (report, grip) = node.memory.state, REPORTS[heard]
    node.on_report(end(outcome, report.segment if segment_known else -1), grip, plan)
    state = node.memory.state
    if before is TaskState.RETREATING:
        assert state is TaskState.DONE
    elif before is TaskState.WORKING:
        assert state in PLANNABLE
    else:
        assert state is TaskState.ASKS
    assert not (node.memory.placed and state not in SETTLED)


@pytest.mark.parametrize("heard", [2, 6], ids=["gripping", "releasing"])
@pytest.mark.parametrize("grip", [CLOSED, UNKNOWN])
def test_a_switch_that_nobody_confirmed_is_asked_about_when_the_plan_is_not_known_any_more(tmp_path, heard, grip):
    node = Node(tmp_path / "ledger")
    run(node, REPORTS[: heard + 1])
    lines = node.ledger.lines
    node.on_report(end("stopped", 4), grip, UNKNOWN_PLAN)
    assert node.memory.state is TaskState.ASKS and not node.memory.placed
    assert node.ledger.lines == lines + 1


def test_a_stop_before_the_grip_asks_nobody_even_if_the_tool_is_not_known(tmp_path):
    node = Node(tmp_path / "ledger")
    run(node, REPORTS[:1])
    node.on_report(end("stopped", 0), UNKNOWN)
    assert node.memory.state is TaskState.READY


def test_a_stop_on_the_way_to_the_grip_asks_unless_the_tool_is_surely_open(tmp_path):
    for number, (grip, state) in enumerate(
        ((OPEN, TaskState.READY), (CLOSED, TaskState.ASKS), (UNKNOWN, TaskState.ASKS))
    ):
        node = Node(tmp_path / str(number))
        run(node, REPORTS[:2])
        node.on_report(end("stopped", 1), grip)
        assert node.memory.state is state


def test_an_element_that_is_in_the_grip_is_carried_on(tmp_path):
    node = Node(tmp_path / "ledger")
    run(node, REPORTS[:5])
    node.on_report(end("held", 2), CLOSED)
    node.add(Entry("answered", "stud", "E", answer="in_grip", person="eva"))
    assert node.memory.state is TaskState.CARRIED
    node.add(Entry("offered", "stud", "E", offer="o2"))
    carried = PlanActions("p2", grips=-1, releases=1)
    for report in (
        play(0, plan_id="p2"),
        play(1, True, plan_id="p2"),
        play(1, True, True, plan_id="p2"),
        play(2, plan_id="p2"),
        end("finished", plan_id="p2"),
    ):
        for entry in events_of_report(node.memory, carried, report, CLOSED, STANDS):
            node.add(entry)
    assert node.memory.state is TaskState.DONE and node.memory.placed


def test_other_plans_are_none_of_its_business(tmp_path):
    node = Node(tmp_path / "ledger")
    run(node, REPORTS[:3])
    for report in (play(0, plan_id="other"), end("", plan_id=""), end("finished", plan_id="other")):
        assert events_of_report(node.memory, PLAN, report, OPEN) == []


@pytest.mark.parametrize(
    ("segment", "before", "confirmed", "events", "state"),
    [
        (1, [], True, ["gripped", "stopped"], (TaskState.ASKS, True, False)),
        (1, [], False, ["stopped"], (TaskState.ASKS, False, False)),
        (3, ["gripped", "releasing"], True, ["released", "stopped"], (TaskState.DONE, False, True)),
        (3, ["gripped", "releasing"], False, ["stopped"], (TaskState.ASKS, True, False)),
    ],
)
def test_what_the_tool_did_before_a_stop_is_written_when_the_engagement_says_so(
    tmp_path, segment, before, confirmed, events, state
):
    """Between the confirmation and the scene's change: the engagement knows, no report said it."""
    node = Node(tmp_path / "ledger")
    node.add(Entry("offered", "stud", "E1", offer="o1", pose=HELD_AS))
    for event in ["planned", "begun", "gripping", *before]:
        node.add(Entry(event, "stud", "E1", plan="p1", offer="o1"))
    entries = events_of_report(node.memory, PLAN, end("stopped", segment), CLOSED, STANDS, "measured", confirmed)
    assert [entry.event for entry in entries] == events
    for entry in entries:
        node.add(entry)
    memory = node.memory
    assert (memory.state, memory.in_grip, memory.placed) == state
    node.ledger.close()


HELD = SceneChange((SceneObject("E1/0", "box", (0.1, 0.1, 0.1), link="tool0"),))
MOTION = (Segment("carry", 1.0, False, (), (), "a", "a"), SceneChange())
CLOSE, OPEN_IT = (
    (replace(MOTION[0], switches=(Switch("vacuum", value, (), 1.0),)), change)
    for value, change in ((True, HELD), (False, SceneChange()))
)


@pytest.mark.parametrize(
    ("ends", "in_grip", "found"),
    [
        ((MOTION, CLOSE, MOTION, OPEN_IT, MOTION), False, (1, 3)),
        # to be sure that it is open is no letting go, unless something is held
        ((OPEN_IT, CLOSE, OPEN_IT), False, (1, 2)),
        ((MOTION, OPEN_IT, MOTION), True, (-1, 1)),
        ((MOTION, OPEN_IT, MOTION), False, (-1, -1)),
        # let go is where it is let go first
        ((CLOSE, OPEN_IT, OPEN_IT), False, (0, 1)),
        # a grip that carries nothing takes no element
        (((CLOSE[0], SceneChange()), OPEN_IT), False, (-1, -1)),
        ((MOTION, MOTION), True, (-1, -1)),
    ],
)
def test_where_a_plan_grips_and_lets_go(ends, in_grip, found):
    plan = plan_actions("p1", TaskMemory("stud", in_grip=in_grip), *zip(*ends), work_samples.tool().tool)
    assert plan == PlanActions("p1", *found)


def test_of_a_plan_that_is_not_known_any_more_only_a_finish_tells_that_it_let_go():
    held, empty = TaskMemory("stud", in_grip=True), TaskMemory("stud")
    assert actions_by_outcome("p1", held, FINISHED) == PlanActions("p1", -1, 0)
    assert actions_by_outcome("p1", empty, FINISHED) == PlanActions("p1", 0, 0)
    assert actions_by_outcome("p1", held, "stopped") == PlanActions("p1", -1, -1)


@pytest.mark.parametrize(
    ("output", "inputs", "closed"),
    [
        (True, {"vacuum_reached": True}, True),
        (True, {"vacuum_reached": False}, True),
        (False, {"vacuum_reached": True}, True),
        (False, {"vacuum_reached": False}, False),
        (False, {}, False),
    ],
)
def test_a_grip_is_closed_when_it_is_told_to_hold_or_holds(output, inputs, closed):
    received = Received(lambda _: 1, lambda: False, Path("review.jsonl"))
    received.on_message(ToolReport(True, outputs={"vacuum": output}, inputs=inputs))
    found = received.grip(work_samples.tool().tool)
    assert found == GripReading(True, closed, ("vacuum",) if output else ())
