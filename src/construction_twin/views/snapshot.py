"""The state of one robot at one moment, as values: texts and pictures are made of it without ROS.

SI; joint tuples in the order of `Snapshot.joints`. None stands for "not reported".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from construction_twin.core.reports import ExecutionReport, HoldReport, LinkReport, SyncReport
from construction_twin.robot.plan import Plan

#: States in which a plan could be approved.
READY = {"link": "ARMED", "sync": "IN_SYNC", "execution": "IDLE"}


@dataclass(frozen=True)
class Snapshot:
    """One robot at one moment.

    Attributes:
        robot: Namespace, without slashes.
        now: ROS time [s].
        joints: Length n
        linear: Length n
        hold: Why the gate is closed; None: nothing is known of it.
        plan: Under review.
        silent: How long ``link``, ``sync``, ``execution`` have been silent [s], if too long.
    """

    robot: str
    now: float
    joints: tuple[str, ...]
    linear: tuple[bool, ...]
    link: LinkReport | None = None
    sync: SyncReport | None = None
    execution: ExecutionReport | None = None
    hold: HoldReport | None = None
    plan: Plan | None = None
    silent: Mapping[str, float] = field(default_factory=dict)

    def not_ready(self) -> list[str]:
        """Return why no plan could be approved now, one sentence per reason; empty when one could.

        A system without an arm (`arm:=none`) has no link, and needs none.
        """
        lacking: list[str] = []
        for name, wanted in READY.items():
            facts = getattr(self, name)
            if facts is None:
                if name != "link":
                    lacking.append(f"{name} is silent; expected {wanted}")
            elif name in self.silent:
                seconds = self.silent[name]
                lacking.append(f"{name} has been silent for {seconds:.0f} s; expected {wanted}")
            elif facts.text != wanted:
                lacking.append(f"{name} is {facts.text}, expected {wanted}: {facts.reason}")
        return lacking
