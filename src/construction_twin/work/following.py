"""What the executor's reports mean for the task whose plan it plays: the events to be written, before anybody acts on them.

Pure. The executor goes on from the boundary at which the element is gripped or released only when the scene has changed, and the
scene is changed after these lines are on the disk: without `gripped` no element was carried anywhere, without `released` none was
let go and forgotten.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from construction_twin.core.reports import ExecutionReport
from construction_twin.core.sentences import Sentence, has
from construction_twin.review.record import Fate
from construction_twin.robot.segments import Segment
from construction_twin.robot.tool import Tool
from construction_twin.scene.scene_change import SceneChange
from construction_twin.work.task_memory import Entry, TaskMemory
from construction_twin.work.task_states import UNDER_WAY, TaskEvent, TaskState

#: Outcome of a plan that reached its end.
FINISHED = "finished"


@dataclass(frozen=True)
class Followed:
    """A plan, as far as it is followed.

    Attributes:
        grips, releases: Numbers of the segments at whose ends the element is gripped and let go; negative: it does not, or that is
            not known.
        works: Number of the first engaged segment, before which nothing is done to an element that stays; negative: there is none,
            or that is not known.
    """

    id: str
    grips: int
    releases: int
    works: int = -1


@dataclass(frozen=True)
class GripReading:
    """What the tool says of its grip.

    Attributes:
        closed: An output commands it to hold, or an input says that it does; meaningless where it is not known.
        commanded: The outputs that command it to hold, as they read back; empty where it is not known.
    """

    known: bool
    closed: bool
    commanded: tuple[str, ...] = ()

    @property
    def surely_open(self) -> bool:
        """Whether nothing can be held."""
        return self.known and not self.closed


def followed(
    plan_id: str, memory: TaskMemory, segments: Sequence[Segment], changes: Sequence[SceneChange], tool: Tool
) -> Followed:
    """Return a plan of a task as it is followed: where it grips the element, and where it lets go of it."""
    grips, releases = -1, -1
    for number, (segment, change) in enumerate(zip(segments, changes)):
        for switch in segment.switches:
            if tool.grip.set.get(switch.output) == switch.value and change.carries:
                grips = number
            lets_go = tool.release.set.get(switch.output) == switch.value
            if lets_go and releases < 0 and (grips >= 0 or memory.in_grip):
                releases = number
    works = next((number for number, segment in enumerate(segments) if segment.engaged), -1)
    return Followed(plan_id, grips, releases, works)


def followed_unseen(plan_id: str, memory: TaskMemory, outcome: str) -> Followed:
    """Return a plan of a task that is not known any more, by its outcome: nothing tells of its segments, only of its end."""
    if memory.stays:
        return Followed(plan_id, -1, -1)
    if outcome == FINISHED:
        return Followed(plan_id, -1 if memory.in_grip else 0, 0)
    return Followed(plan_id, -2, -2)


def grip_of(tool: Tool, outputs: Mapping[str, bool], inputs: Mapping[str, bool]) -> GripReading:
    """Return what a tool's outputs and inputs, read back, say of its grip."""
    asked = tuple(name for name, value in tool.grip.set.items() if outputs.get(name) == value)
    holds = any(inputs.get(name) == value for name, value in tool.grip.confirm.items())
    return GripReading(True, bool(asked) or holds, asked)


class _Events:
    """Collects the events of one task; its state after them is computed as the ledger computes it."""

    def __init__(self, memory: TaskMemory, plan: str):
        self.memory, self._plan = memory, plan
        self.entries: list[Entry] = []

    @property
    def state(self) -> TaskState:
        """The task's, after them."""
        return self.memory.state

    def add(self, event: TaskEvent, reason: str = "", pose: tuple[float, ...] = (), source: str = "") -> None:
        """Add one event."""
        entry = Entry(event.value, self.memory.task, plan=self._plan, pose=pose, source=source, reason=reason)
        self.memory = self.memory.then(entry)
        self.entries.append(entry)


def follow(
    memory: TaskMemory,
    plan: Followed,
    report: ExecutionReport,
    grip: GripReading,
    as_built: tuple[float, ...] = (),
    source: str = "",
    confirmed: bool = False,
) -> list[Entry]:
    """Return the events that a report adds to the task of a plan; none when it says nothing new of it.

    Args:
        as_built: Length 7 or 0. Where the element stands if it is let go now; empty: not known.
        confirmed: The plan has ended at the end of the report's segment, and the tool did there what was asked of it.
    """
    if report.plan_id != plan.id or memory.state not in (TaskState.PLANNED, *UNDER_WAY):
        return []
    events = _Events(memory, plan.id)
    if memory.state is TaskState.PLANNED:
        if not report.playing and not report.ended:
            return []
        if not memory.plan:
            events.add(TaskEvent.PLANNED)
        events.add(TaskEvent.BEGUN)
    # what lies behind, up to the present segment; a plan that has come to its end has been through everything
    segment = 10**6 if report.ended == FINISHED else report.segment
    stands = report.at_boundary or report.wants_scene or confirmed
    confirmed = confirmed or (report.wants_scene and report.playing)

    def behind(number: int, at_its_end: bool) -> bool:
        # of a plan that is not known any more, no segment says that the grip closed or let go
        return number >= 0 and (segment > number or (segment == number and at_its_end))

    if events.state is TaskState.WORKING and behind(plan.grips, stands):
        events.add(TaskEvent.GRIPPING)
    if events.state is TaskState.GRIPPING and behind(plan.grips, confirmed):
        events.add(TaskEvent.GRIPPED)
    if events.state is TaskState.CARRYING and behind(plan.releases, stands):
        events.add(TaskEvent.RELEASING)
    if events.state is TaskState.RELEASING and behind(plan.releases, confirmed):
        events.add(TaskEvent.RELEASED, pose=as_built, source=source if as_built else "")
    if report.ended:
        _end(events, plan, report, grip)
    return events.entries


def _end(events: _Events, plan: Followed, report: ExecutionReport, grip: GripReading) -> None:
    reason = f"{report.outcome}: {report.reason}"
    if events.state is TaskState.WORKING and events.memory.stays:
        # from the first engaged segment on only a person sees what was done
        stopped = TaskEvent.STOPPED if 0 <= report.segment < plan.works else TaskEvent.UNKNOWN
        events.add(TaskEvent.FINISHED if report.outcome == FINISHED else stopped, reason)
        return
    if events.state is TaskState.RETREATING and report.outcome == FINISHED:
        events.add(TaskEvent.FINISHED, reason)
        return
    if events.state is TaskState.WORKING and not (0 <= report.segment < plan.grips or grip.surely_open):
        # from the segment on at whose end the grip closes, it may have closed: unless the tool says that it did not
        events.add(TaskEvent.GRIPPING)
    surely_not = events.state is TaskState.GRIPPING and grip.surely_open
    events.add(TaskEvent.NOT_GRIPPED if surely_not else TaskEvent.STOPPED, reason)


def after_restart(memory: TaskMemory, fate: Fate, grip: GripReading) -> list[Entry]:
    """Return the events of a task whose plan the executor does not report any more, or never did."""
    events = _Events(memory, fate.plan or memory.plan)
    if memory.state is TaskState.PLANNED:
        if fate.under_review:
            if not memory.plan:
                events.add(TaskEvent.PLANNED)
        elif fate.approved is False:
            events.add(TaskEvent.DROPPED, Sentence("work.event.never_approved"))
        elif grip.surely_open and not memory.in_grip and not memory.stays:
            # nothing can have been carried: the line that must be written before is not there
            events.add(TaskEvent.DROPPED, Sentence("work.event.nothing_gripped"))
        else:
            events.add(TaskEvent.UNKNOWN, Sentence("work.event.plan_unknown"))
    elif memory.state is TaskState.WORKING and grip.surely_open and not memory.stays:
        events.add(TaskEvent.STOPPED, Sentence("work.event.nothing_gripped"))
    elif memory.state is TaskState.GRIPPING and grip.surely_open:
        events.add(TaskEvent.NOT_GRIPPED, Sentence("work.event.nothing_gripped"))
    elif memory.state in UNDER_WAY:
        events.add(TaskEvent.UNKNOWN, Sentence("work.event.end_unknown", state=memory.state.value))
    return events.entries


def question(memory: TaskMemory, element_name: str) -> str:
    """Return what a person is asked about a task; empty when nothing."""
    if memory.state is not TaskState.ASKS:
        return ""
    if memory.stays:
        return Sentence(
            "work.question.done", element=element_name, known=_known(f"work.known.stays.{memory.before.value}")
        )
    return Sentence("work.question.where", element=element_name, known=known_of(memory))


def known_of(memory: TaskMemory) -> str:
    """Return what is known last of where the element of a task is that asks."""
    if memory.source:
        return Sentence("work.known.elsewhere", ledger=memory.source)
    # of an element that waits, the state says as little as of one that is ready; unless another task has placed it
    waits = memory.before in (TaskState.WAITING, TaskState.READY)
    before = memory.before if not waits else TaskState.DONE if memory.placed else TaskState.WAITING
    return _known(f"work.known.{before.value}")


def _known(key: str) -> str:
    """Return what is known of a task whose end is not; where there are no words for its state, the state's own."""
    return Sentence(key) if has(key) else key.rpartition(".")[2]
