"""speed_limits: merges what limits the speed; executor and bridge hear it alone. The lowest wins, and is repeated.

Sources: one program on `speed_limit`, and people by the service `limit_speed`, which `mqtt_review` calls. What people set is kept
in a file, so that a restart raises nothing: a raise is in force once it is on the disk, a lower limit at once. Not safety rated.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pydantic
import rospy

from construction_twin.core.errors import ConfigurationError, ExpiredError, PayloadError
from construction_twin.core.files import read_file, write_in_place
from construction_twin.core.reports import SpeedChange, SpeedReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.speed_limit import LimitState, SpeedLimit
from construction_twin.link.speed_limits import PeopleLimit, SpeedLimits, kept, program_text, remembered, unreadable
from construction_twin.msg import SpeedChange as SpeedChangeMessage
from construction_twin.msg import SpeedLimit as SpeedLimitMessage
from construction_twin.msg import SpeedLimitInForce
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.records import to_msg
from construction_twin.ros.shared.deferred_log import DeferredLog
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.endpoint import TOO_OLD
from construction_twin.ros.shared.launch_arguments import arm_of
from construction_twin.ros.shared.node_shell import ConfigFile, NodeShell
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.params import ros_home, settings_of
from construction_twin.ros.shared.ports import (
    Every,
    Interface,
    Ports,
    Publication,
    Served,
    SharedParameter,
    Subscription,
    has_arm,
)
from construction_twin.ros.shared.robot_clock import present
from construction_twin.ros.shared.stop_memory import StopMemory
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.ros.transport.publisher import Sink
from construction_twin.ros.transport.subscriber import caller_of
from construction_twin.srv import LimitSpeed, LimitSpeedRequest

#: The program that was heard, for the node after this one; in the robot's namespace, cleared by the launch file.
PROGRAM = "speed_limit_program"
#: A file that could not be written is tried again, and lines are written to the log, after this time [s].
_AGAIN = 0.5
#: So long the answer to a lower limit, which acts already, waits for the disk [s]: one that hangs holds up no lower one.
PATIENCE = 0.5
#: Largest file that is read, and the least that it has [bytes].
MOST, ROOM = 1 << 16, 4096

#: Between two messages of the limit in force [s], well below `speed_limit_deadline` of executor and gateway. A program's silence is
#: noticed up to one period late.
PERIOD = 0.05


class Settings(pydantic.BaseModel):
    """Private parameters; see config/speed_limits.yaml."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    arm: Literal["mock", "real", "none"]
    folder: str


class SourceRules(pydantic.BaseModel):
    """What executor and gateway are told of a source's silence: parameters of theirs, which hold where it is heard, too."""

    speed_limit_deadline: float = pydantic.Field(gt=0)
    speed_limit_silent: float = pydantic.Field(ge=0, le=1)
    speed_limit_required: bool = False


class LimitFile:
    """The file in which the limit of people outlasts the node.

    It has its room from the first start on and is written in place, so a disk that is full later takes every limit. Beside it lies
    a mark that there was one: what is not there any more is not known.

    Args:
        path: None: it ends with the node.
    """

    def __init__(self, path: Path | None):
        self._path = path

    def read(self) -> PeopleLimit:
        """Return what people had set; the least where that is not known, or where no other could be kept."""
        if self._path is None:
            return PeopleLimit()
        mark = self._path.with_suffix(".mark")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            is_first = not mark.exists() and not self._path.exists()
            mark.touch()
            people = PeopleLimit() if is_first else kept(str(self._path), read_file(self._path, MOST).decode("utf-8"))
            write_in_place(self._path, people.to_text(), ROOM)
        except (OSError, UnicodeDecodeError, ConfigurationError) as error:
            return unreadable(str(error))
        return people

    def write(self, people: PeopleLimit) -> str:
        """Write it; return why that was not possible, "" when it was. What could not be written is not known after a restart."""
        if self._path is None:
            return ""
        try:
            write_in_place(self._path, people.to_text(), ROOM)
        except OSError as error:
            with contextlib.suppress(OSError):
                self._path.unlink()
            path, problem = str(self._path), error.strerror or str(error)
            return Sentence("link.speed.not_written", path=path, problem=problem)
        return ""


class SpeedLimitsNode:
    """ROS around a SpeedLimits; `start` gives it parameters, topics and service.

    Args:
        file: Keeps what people set.
        memory: Keeps which program was heard.
        in_force, changes: Get what is in force, and what a person has set, for the record.
        diagnostics: Counts what is refused.
    """

    def __init__(
        self,
        limits: SpeedLimits,
        file: LimitFile,
        memory: StopMemory,
        in_force: Sink,
        changes: Sink,
        diagnostics: NodeDiagnostics,
    ):
        self._limits = limits
        self._file, self._problem = file, ""
        # what the file holds; None: it is not known. The lock is held while the disk is waited for
        self._kept: PeopleLimit | None = limits.people
        self._file_lock = threading.Lock()
        self._memory = memory
        self._publisher, self._changes = in_force, changes
        self._diagnostics = diagnostics
        # also orders what is published: the last message is what was decided last
        self._lock = threading.Lock()
        self._news, self._tried = threading.Event(), threading.Condition()
        self._log = DeferredLog()
        self._state: LimitState | None = None
        self._told: SpeedReport | None = None

    def run(self) -> None:
        """Keep what people set, and write the log, until shutdown; nothing else here waits for a disk or a terminal."""
        while not rospy.is_shutdown():
            self._news.wait(_AGAIN)
            self._news.clear()
            self.write()
        self.write()

    def write(self) -> None:
        """Write what has changed."""
        with self._file_lock:
            people = self._limits.people
            # an unreadable file stays as it is until a person has set a limit
            if people != self._kept:
                self._write(people)
        with self._tried:
            self._tried.notify_all()
        self._log.flush()

    def _write(self, people: PeopleLimit) -> None:
        """Write a limit, which nobody else does meanwhile."""
        self._problem = self._file.write(people)
        self._kept = None if self._problem else people
        if self._problem:
            rospy.logerr_throttle(5.0, "%s", self._problem)

    def on_program(self, message: SpeedLimitMessage) -> None:
        """Take what a program allows; it is in force at once."""
        source = caller_of(message)
        try:
            with self._lock:
                self._limits.program.accept(message.limit, source, time.monotonic_ns(), message.reason)
                self._publish()
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))

    def on_limit_speed(self, request: LimitSpeedRequest) -> Outcome:
        """Take what a person sets: a lower limit is in force before anything is written, a higher one is written first."""
        given = request.limit, request.person, request.moment
        try:
            if self._is_raise(request.limit):
                self._keep_raise(*given)
            with self._lock:
                before = self._limits.people
                sentence = self._limits.set(*given, present(), now_ns())
                self._publish()
                if self._limits.people != before:
                    self._tell_change(self._limits.people)
        except (PayloadError, ExpiredError) as error:
            expired = isinstance(error, ExpiredError)
            self._diagnostics.refuse(error.reason if isinstance(error, PayloadError) else TOO_OLD, str(error))
            # a raise that somebody has overtaken is on the disk
            self._news.set()
            return Outcome(False, str(error), expired, {"limit": self._limits.people.limit})
        self._log.add(rospy.loginfo, "%s: %s", request.person, sentence)
        self._news.set()
        with self._tried:
            self._tried.wait_for(lambda: self._kept == self._limits.people or self._problem, PATIENCE)
        return Outcome(True, sentence, fields={"limit": self._limits.people.limit})

    def _is_raise(self, limit: float) -> bool:
        return limit > self._limits.people.limit

    def _keep_raise(self, limit: float, person: str, moment: str) -> None:
        """Write a higher limit before it is in force; PayloadError (``file``) when it cannot be, or as `SpeedLimits.set`."""
        with self._file_lock:
            with self._lock:
                wanted = self._limits.asked(limit, person, moment, present(), now_ns())
            self._write(wanted)
            if self._problem:
                raise PayloadError("file", Sentence("link.speed.not_raised", problem=self._problem))

    def repeat(self) -> None:
        """Publish what is in force again, and notice a program's silence; to be called at `rate`."""
        now = time.monotonic_ns()
        with self._lock:
            self._publish()
            program = self._limits.program
            state, reason, text = program.state, program.reason, program_text(program)
        self._memory.keep(text, now)
        if state is not self._state:
            self._state = state
            self._log.add(rospy.logwarn if _is_slow(state) else rospy.loginfo, "%s", reason)

    def _publish(self) -> None:
        self._told = report = self._limits.report(time.monotonic_ns())
        if report is not None:
            self._publisher.publish(to_msg(replace(report, stamp=now_ns()), SpeedLimitInForce))

    def _tell_change(self, people: PeopleLimit) -> None:
        change = SpeedChange(people.person, people.limit, people.replaced, people.replaced_person, people.since)
        self._changes.publish(to_msg(change, SpeedChangeMessage))

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        told = self._told or SpeedReport(reason=self._limits.program.reason)
        values = {
            "speed limit": f"{told.limit:.3f}",
            "speed limit of people": f"{told.people:.3f}",
            "set by": told.person,
            "replaced": f"{told.replaced:.3f}",
            "replaced was set by": told.replaced_person,
            "speed limit of a program": f"{told.program:.3f}",
            "program": told.program_name,
        }
        sentence = f"speed limit {told.limit:g}: {told.reason}"
        if self._problem:
            return Report(ERROR, self._problem, values)
        if self._memory.problem:
            forgotten = f"which program was heard would not outlast this node: {PROGRAM} was not written"
            return Report(ERROR, forgotten, values)
        if self._limits.people.problem:
            return Report(ERROR, sentence, values)
        return Report(WARN if _is_slow(self._limits.program.state) else OK, sentence, values)


def _is_slow(state: LimitState) -> bool:
    return state in (LimitState.SILENT, LimitState.MISSING)


def source_of_program(executor: Mapping[str, object], gateway: Mapping[str, object] | None) -> SpeedLimit:
    """Return what hears a program: with the shorter deadline, and the lower fraction for silence, of executor and gateway.

    Each of them still has its own for the silence of this node.

    Args:
        executor, gateway: Their parameters; no gateway without an arm.
    """
    rules = [settings_of(SourceRules, executor, "executor")]
    if gateway is not None:
        rules.append(settings_of(SourceRules, gateway, "gateway"))
    deadline = min(each.speed_limit_deadline for each in rules)
    silent = min(each.speed_limit_silent for each in rules)
    return SpeedLimit(deadline, silent, rules[0].speed_limit_required)


def start(settings: Settings, robot: RobotModel, ports: Ports) -> SpeedLimitsNode:
    """Return the node with its parameters, topics and service."""
    program = source_of_program(ports.parameters["executor"], ports.parameters["gateway"])
    before = str(ports.parameters[PROGRAM])
    remembered(program, before, time.monotonic_ns())
    outlasts = bool(settings.folder) and has_arm(settings)
    file = LimitFile(ros_home() / settings.folder / f"{robot.name}.json" if outlasts else None)
    limits = SpeedLimits(program, file.read(), present())
    if limits.people != PeopleLimit():
        rospy.loginfo("%s", limits.people.reason)
    memory = StopMemory(before, ports.keeper(PROGRAM), PROGRAM)
    in_force, changes = (ports.publishers[name] for name in ("speed_limit_in_force", "speed_change"))
    return SpeedLimitsNode(limits, file, memory, in_force, changes, ports.diagnostics)


INTERFACE = Interface(
    report=SpeedLimitsNode.report,
    parameters=(
        SharedParameter("executor", {}),
        SharedParameter("gateway"),
        SharedParameter(PROGRAM, "", kept=True),
    ),
    publishes=(
        Publication("speed_limit_in_force", SpeedLimitInForce, queue_size=5, latch=True, tcp_nodelay=True),
        Publication("speed_change", SpeedChangeMessage, queue_size=50),
    ),
    hears=(Subscription("speed_limit", SpeedLimitMessage, SpeedLimitsNode.on_program, queue_size=5, tcp_nodelay=True),),
    serves=(Served("limit_speed", LimitSpeed, SpeedLimitsNode.on_limit_speed),),
    every=(Every(lambda _settings: PERIOD, lambda node, _ports: node.repeat()),),
)
NODE = NodeShell("speed_limits", Settings, start, INTERFACE, file=ConfigFile(lambda given: {"arm": arm_of(given)}))


def main() -> None:
    """Run the node."""
    NODE.run()
