"""An executor behind a gate that holds and opens again, as the monitor does under the policy `resume`; for the tests of holds."""

from __future__ import annotations

from executor_bench import ROBOT, Bench

from construction_twin.core.errors import MotionRefused
from construction_twin.core.limits import MotionCheck, MotionLimits
from construction_twin.core.units import CYCLE_NS
from construction_twin.execution.executor import ExecutorState
from construction_twin.monitor.gate import SyncState
from construction_twin.mqtt.joint_string import JointStringCodec

LIMITS = MotionLimits.of(ROBOT)
#: The gate stays closed this long, as with the shipped `agree_time`: the executor has heard of the hold long before [ns].
AGREE_TIME = 25 * CYCLE_NS


class HoldBench(Bench):
    """A bench whose gate rounds, checks every setpoint with the gate's own check, and can be closed; MotionRefused ends a test.

    Args:
        decimals: Of a degree on the wire.
        hears_after: Cycles until the executor hears what the gate does.
    """

    def __init__(self, decimals: int = 3, hears_after: int = 0):
        super().__init__()
        self.codec = JointStringCodec.of(ROBOT, decimals)
        self._hears_after = hears_after
        self._news: list[tuple[int, SyncState, int]] = []
        self._check = MotionCheck(LIMITS, decimals)
        self.open = False
        self.held_stamp = 0
        self._closed_at = 0
        #: Numbers of the outputs with which the executor went back to a held setpoint.
        self.holds: list[int] = []

    def step(self):
        """One cycle; return the setpoint."""
        self.stamp += CYCLE_NS
        self._tell()
        setpoint = self.executor.step(self.stamp, self.stamp)
        self.outputs.append(setpoint)
        if setpoint is not None:
            self._pass(setpoint)
        self.executor.on_twin(self.stamp, self.twin, self.stamp)
        return setpoint

    def close(self, state: SyncState = SyncState.HOLDING) -> None:
        """Hold from the next setpoint on."""
        self.open, self._closed_at = False, self.stamp
        self._news.append((self.stamp + self._hears_after * CYCLE_NS, state, self.held_stamp))

    def try_to_open(self) -> bool:
        """Open as the gate does: some time later, when the executor's setpoint continues from the held pose."""
        if self.stamp - self._closed_at < AGREE_TIME:
            return False
        trial = MotionCheck(LIMITS, self.codec.decimals)
        trial.start(self.stamp - CYCLE_NS, self.twin)
        try:
            trial.accept(self.stamp, self.codec.quantise(self.outputs[-1]))
        except MotionRefused:
            return False
        self._check.start(self.stamp, self.twin)
        self.open = True
        return True

    def ready(self) -> HoldBench:
        """Let twin and arm agree."""
        self.twin = self.codec.quantise(self.twin)
        self._check.start(self.stamp, self.twin)
        self.open = True
        super().ready()
        self.executor.on_sync(SyncState.IN_SYNC, True, "resume", self.held_stamp)
        return self

    def _tell(self) -> None:
        while self._news and self._news[0][0] <= self.stamp:
            _, state, held = self._news.pop(0)
            was = self.state
            self.executor.on_sync(state, state is SyncState.IN_SYNC, "resume", held)
            if self.state is ExecutorState.HELD is not was:
                self.holds.append(len(self.outputs))

    def _pass(self, setpoint: tuple[float, ...]) -> None:
        if self.open:
            command = self.codec.quantise(setpoint)
            self._check.accept(self.stamp, command)
            self.twin, self.held_stamp = command, self.stamp
            self._news.append((self.stamp + self._hears_after * CYCLE_NS, SyncState.IN_SYNC, self.stamp))
