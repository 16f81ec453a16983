"""The speed limit in ROS: of one program on `speed_limit`, of people by `limit_speed`; the lowest is published, and repeated.

Beside the gate, in threads of its own: no setpoint waits for its lock or file. A raise of people is on the disk before it acts, a
lower limit acts at once: a restart raises nothing. Not safety rated.
"""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path

import pydantic
import rospy

from construction_twin.core.errors import ExpiredError, PayloadError
from construction_twin.core.freshness import TOO_OLD, present
from construction_twin.core.reports import SpeedChange
from construction_twin.core.speed_limit import LimitState, SpeedLimit
from construction_twin.gateway.config import GatewayConfig
from construction_twin.link.speed_limits import NOBODY, UNKNOWN, SpeedLimits, read_people, write_people
from construction_twin.msg import SpeedChange as SpeedChangeMessage
from construction_twin.msg import SpeedLimit as SpeedLimitMessage
from construction_twin.msg import SpeedLimitInForce
from construction_twin.ros.messages.records import to_msg
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, Report
from construction_twin.ros.shared.node_shell import Ports
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.params import settings_of
from construction_twin.ros.shared.stop_memory import StopMemory
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.ros.transport.subscriber import caller_of
from construction_twin.srv import LimitSpeedRequest

#: Parameter of the robot: what holds while the program that was heard is silent, and its name. The launch file clears it.
PROGRAM = "speed_limit_program"
#: Between two messages of the limit in force, well below `speed_limit_deadline`, and between two tries to write a file [s].
PERIOD, AGAIN = 0.05, 0.5
#: So long the answer to a lower limit, which acts already, waits for the disk [s]: one that hangs holds up no lower one.
PATIENCE = 0.5


class Rules(pydantic.BaseModel):
    """What executor or gateway is told of a source that falls silent, among their other parameters; see config/executor.yaml."""

    speed_limit_deadline: float = pydantic.Field(GatewayConfig.speed_limit_deadline, gt=0)
    speed_limit_silent: float = pydantic.Field(GatewayConfig.speed_limit_silent, ge=0, le=1)
    speed_limit_required: bool = False


class SpeedLimitService:
    """ROS around a SpeedLimits; the file `path` keeps what people set, None: it ends with the process."""

    def __init__(self, path: Path | None, ports: Ports):
        # the stricter of what executor and gateway are told holds here; without an arm there is no gateway
        told = {name: ports.parameters[name] for name in ("executor", "gateway") if ports.parameters[name] is not None}
        rules = [settings_of(Rules, given, rospy.resolve_name(name)) for name, given in told.items()]
        deadline = min(each.speed_limit_deadline for each in rules)
        silent = min(each.speed_limit_silent for each in rules)
        program = SpeedLimit(deadline, silent, rules[0].speed_limit_required)
        fraction, _, name = ports.parameters[PROGRAM].partition(" ")
        if name:
            # a process before this one has heard it: it is silent until it is heard again
            program.hear(float(fraction), name, time.monotonic_ns() - round(2e9 * deadline) - 1)
        self._memory = StopMemory(ports.parameters[PROGRAM], ports.keeper(PROGRAM), PROGRAM)
        people, problem = read_people(path) if path else (NOBODY, "")
        self._limits = SpeedLimits(program, people, present(), problem)
        # what the file holds, and a lock that is held while the disk is waited for
        self._path, self._kept, self._file_problem, self._file_lock = path, people, "", threading.Lock()
        self._in_force, self._changes = (ports.publishers[name] for name in ("speed_limit_in_force", "speed_change"))
        self._refuse = ports.diagnostics.refuse
        # also orders what is published: the last message is what was decided last
        self._lock = threading.Lock()

    def on_program(self, message: SpeedLimitMessage) -> None:
        """Take what a program allows; it is in force at once."""
        try:
            with self._lock:
                self._limits.program.accept(message.limit, caller_of(message), time.monotonic_ns(), message.reason)
                self._publish()
        except PayloadError as error:
            self._refuse(error.reason, str(error))

    def on_limit_speed(self, request: LimitSpeedRequest) -> Outcome:
        """Take what a person sets: a lower limit is in force before anything is written, a higher one is written first."""
        given, limits = (request.limit, request.person, request.moment), self._limits
        try:
            if request.limit > limits.people.limit:
                with self._file_lock:
                    self._write(limits.asked(*given, present(), now_ns()))
                    if self._file_problem:
                        raise PayloadError("file", f"the speed limit of people is not raised: {self._file_problem}")
            with self._lock:
                before, sentence = limits.people, limits.set(*given, present(), now_ns())
                self._publish()
                if limits.people is not before:
                    self._changes.publish(to_msg(limits.people, SpeedChangeMessage))
        except (PayloadError, ExpiredError) as error:
            self._refuse(error.reason if isinstance(error, PayloadError) else TOO_OLD, str(error))
            return Outcome(False, str(error), isinstance(error, ExpiredError), {"limit": limits.people.limit})
        writer = threading.Thread(target=self.write, name="speed limit", daemon=True)
        writer.start()
        writer.join(PATIENCE)
        return Outcome(True, sentence, fields={"limit": limits.people.limit})

    def write(self) -> None:
        """Write what people have set, where the file does not hold it; for a thread that may wait for a disk."""
        with self._file_lock:
            # an unreadable file stays as it is until a person has set a limit
            if self._limits.people != self._kept:
                self._write(self._limits.people)

    def _write(self, people: SpeedChange) -> None:
        self._file_problem = write_people(self._path, people) if self._path else ""
        self._kept = UNKNOWN if self._file_problem else people

    def repeat(self) -> None:
        """Publish what is in force again, and notice a program's silence; to be called every `PERIOD`."""
        program = self._limits.program
        with self._lock:
            self._publish()
            # it changes seldom, however often the limit does
            memory = f"{int(100 * program.fraction_when_silent) / 100:g} {program.name}" if program.name else ""
        self._memory.keep(memory, time.monotonic_ns())

    def _publish(self) -> None:
        if report := self._limits.report(time.monotonic_ns()):
            self._in_force.publish(to_msg(replace(report, stamp=now_ns()), SpeedLimitInForce))

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        program = self._limits.program
        with self._lock:
            said = self._limits.report(time.monotonic_ns())
        limit, reason = (said.limit, said.reason) if said else (1.0, program.reason)
        values = {"speed limit": f"{limit:.3f}", "speed limit because": reason}
        slow = program.state in (LimitState.SILENT, LimitState.MISSING)
        problem = self._file_problem or self._memory.problem
        level = ERROR if problem or self._limits.problem else WARN if slow else OK
        return Report(level, problem or f"speed limit {limit:g}: {reason}", values)
