"""The state of one robot at one moment, as values: texts and pictures are made of it without ROS.

SI; joint tuples in the order of `Snapshot.joints`. None stands for "not reported".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from construction_twin.robot.plan import Plan

#: States in which a plan could be approved.
READY = {"link": "ARMED", "sync": "IN_SYNC", "execution": "IDLE"}


@dataclass(frozen=True)
class LinkFacts:
    """The bridge's report; see Link.msg.

    Attributes:
        counters: The gateway's, and what it says of its playout.
        responsible: Who has armed a bare PLC; empty otherwise.
        not_checked: What is not checked with a bare PLC.
    """

    text: str
    reason: str
    gateway_state: str = ""
    counters: Mapping[str, str] = field(default_factory=dict)
    commands_refused: int = 0
    states_refused: int = 0
    responsible: str = ""
    not_checked: tuple[str, ...] = ()


@dataclass(frozen=True)
class SyncFacts:
    """The gate's report; see Sync.msg.

    Attributes:
        errors, thresholds: Length n. [rad], [m] for prismatic joints; empty while nothing is compared.
        round_trip, servo_lag: [s]; nan when unknown.
    """

    text: str
    reason: str
    policy: str = ""
    comparison: str = ""
    errors: tuple[float, ...] = ()
    thresholds: tuple[float, ...] = ()
    round_trip: float = float("nan")
    servo_lag: float = float("nan")
    violations: int = 0


@dataclass(frozen=True)
class ExecutionFacts:
    """The executor's report; see Execution.msg.

    Attributes:
        start, duration: Nominal time of the plan's first setpoint, 0 for none; its length [s].
        rate, speed_limit: Fraction of the planned speed now, and the fraction that is allowed.
        segment, segment_name: Of a work plan: where it is, from 0; -1 without.
        at_boundary, wants_scene: It stands at the end of that segment; and waits for the scene to change.
        engaged: Only the way back along the executed path can be planned.
    """

    text: str
    reason: str
    plan_id: str = ""
    outcome: str = ""
    start: float = 0.0
    duration: float = 0.0
    rate: float = 0.0
    speed_limit: float = 1.0
    segment: int = -1
    segment_name: str = ""
    at_boundary: bool = False
    wants_scene: bool = False
    engaged: bool = False

    def progress(self, now: float) -> float | None:
        """Return how much of a plan's time is over at `now` [s], 0 to 1; None unless a plan is being played."""
        if self.text != "PLAYING" or not self.start or self.duration <= 0.0:
            return None
        return min(1.0, max(0.0, (now - self.start) / self.duration))


@dataclass(frozen=True)
class NodeFacts:
    """What a node says on `/diagnostics`: its name, the level (0 good, 1 warning, 2 error, 3 silent), one sentence."""

    name: str
    level: int
    sentence: str


@dataclass(frozen=True)
class Snapshot:
    """One robot at one moment.

    Attributes:
        robot: Namespace, without slashes.
        now: ROS time [s].
        joints: Length n
        linear: Length n
        plan: Under review.
        rates: Messages per second on the 250 Hz topics.
        silent: How long ``link``, ``sync``, ``execution`` have been silent [s], if too long.
    """

    robot: str
    now: float
    joints: tuple[str, ...]
    linear: tuple[bool, ...]
    link: LinkFacts | None = None
    sync: SyncFacts | None = None
    execution: ExecutionFacts | None = None
    plan: Plan | None = None
    rates: Mapping[str, float | None] = field(default_factory=dict)
    nodes: tuple[NodeFacts, ...] = ()
    silent: Mapping[str, float] = field(default_factory=dict)

    def not_ready(self) -> list[str]:
        """Return why no plan could be approved now, one sentence per reason; empty when one could.

        A system without an arm (`arm:=none`) has no link, and needs none.
        """
        lacking = []
        for name, wanted in READY.items():
            facts = getattr(self, name)
            if facts is None:
                if name != "link":
                    lacking.append(f"{name} is silent; expected {wanted}")
            elif name in self.silent:
                lacking.append(f"{name} has been silent for {self.silent[name]:.0f} s; expected {wanted}")
            elif facts.text != wanted:
                lacking.append(f"{name} is {facts.text}, expected {wanted}: {facts.reason}")
        return lacking
