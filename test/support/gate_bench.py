"""A gate in its loop, for the tests of the gate."""

from __future__ import annotations

from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.monitor.gate import Gate
from construction_twin.monitor.settings import GateSettings
from construction_twin.monitor.states import SyncState
from construction_twin.mqtt.joint_string import JointStringCodec

LIMITS = MotionLimits(("joint_a1", "joint_a2"), (-2.0, -1.0), (2.0, 1.0), (2.0, 3.0), (3.0, 9.0))
CODEC = JointStringCodec(2, 3)
START = CODEC.quantise((0.3, -0.4))
SETTINGS = GateSettings()
#: The largest first step from rest that joint_a1's acceleration allows [rad].
FIRST_STEP = LIMITS.acceleration[0] * CYCLE * CYCLE


def moved(q: tuple[float, ...], distance: float) -> tuple[float, ...]:
    """Return a pose with joint_a1 moved by a distance [rad]."""
    return (q[0] + distance, q[1])


def states(gate: Gate) -> list[tuple[str, str]]:
    """Return the gate's transitions since the last call: event and new state."""
    return [(change.event.value, change.target.name) for change in gate.pop_transitions()]


class Bench:
    """A gate in its loop: the twin executes what passes, the arm answers, one cycle at a time."""

    def __init__(self, settings: GateSettings = SETTINGS, codec: JointStringCodec = CODEC, pose=START, compares=True):
        self.gate = Gate(LIMITS, codec, settings, compares=compares)
        self.stamp = 1000 * CYCLE_NS
        self.twin = pose
        self.offset = 0.0
        self.feedback = True

    @property
    def state(self) -> SyncState:
        """The gate's state."""
        return self.gate.state

    def cycle(self, theta_next=None, cycles: int = 1):
        """Let one setpoint pass, by default the twin's pose; return the command."""
        self.stamp += cycles * CYCLE_NS
        if self.twin is not None:
            self.gate.on_twin(self.stamp - CYCLE_NS, self.twin)
        if self.feedback and self.twin is not None:
            self.gate.on_physical(moved(self.twin, self.offset), 0, self.stamp)
        command = self.gate.pass_next(self.stamp, self.twin if theta_next is None else theta_next, self.stamp)
        if command is not None:
            self.twin = command
        return command

    def run(self, seconds: float) -> list:
        """Repeat the twin's pose for some time; return the commands."""
        return [self.cycle() for _ in range(round(seconds / CYCLE))]

    def opened(self) -> Bench:
        """Let the gate open."""
        self.run(0.2)
        assert self.state is SyncState.IN_SYNC
        return self

    def advance(self, speed: float, cycles: int, lag: float = 0.0) -> Bench:
        """Move joint_a1, gathering speed at nearly its acceleration limit; the arm follows `lag` seconds behind."""
        target, step = self.twin, 0.0
        for _ in range(cycles):
            self.offset = -lag * step / CYCLE
            step = min(step + 0.9 * FIRST_STEP, speed * CYCLE)
            target = moved(target, step)
            assert self.cycle(target) == CODEC.quantise(target)
        return self
