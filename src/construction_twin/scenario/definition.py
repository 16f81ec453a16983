"""A scenario: what is done to a running cell, when, and what is expected of it.

Values are SI but for keys that end in ``_deg`` and ``_mm``. docs/scenarios.md explains the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

import pydantic

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.units import radians
from construction_twin.mock.faults import KINDS
from construction_twin.validation import StrictModel, wrong_value

_Positive = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]
_NotNegative = Annotated[float, pydantic.Field(ge=0, allow_inf_nan=False)]
#: Topics whose states a step can wait for, and an event can name.
STATES = ("sync", "link", "execution")
#: Services that a step can call: those of a person, of the cell, and of the arm's controller.
Call = Literal["stop", "halt", "pause", "resume", "reset"]
#: A pose has been reached when every joint is this close [deg], 1e-5 rad: rounding to 3 decimals leaves 5e-4.
FINAL_ERROR_DEG = 5.7e-4


class ScenarioError(ConstructionTwinError):
    """A scenario cannot be read, run or judged."""


class Injection(StrictModel):
    """A fault that begins, or ends; fields as in InjectFault.srv, or `value_deg` in place of `value`.

    `end` in place of `on`: in YAML `on` is a boolean.
    """

    fault: Literal[tuple(KINDS)]  # type: ignore[valid-type]  # the names are those of the mock's table
    joint: str = ""
    value: list[pydantic.FiniteFloat] = []
    value_deg: list[pydantic.FiniteFloat] = []
    direction: Literal["", "to_pc", "to_controller"] = ""
    duration: _NotNegative = 0.0
    end: bool = False

    @property
    def values(self) -> list[float]:
        """The values in SI."""
        return self.value or list(radians(self.value_deg))


class Move(StrictModel):
    """A plan to joint angles [deg] that lasts `duration` [s], 0: at the planner's own speed."""

    goal_deg: Annotated[list[pydantic.FiniteFloat], pydantic.Field(min_length=1)]
    duration: _NotNegative = 0.0


class Step(StrictModel):
    """One step of a scenario.

    Attributes:
        when: What it waits for: ``now`` (the step before is done), ``motion`` (the start of the last motion), ``rest`` (the arm
            stands), or a state as ``sync HOLDING``, ``link ARMED``, ``execution HELD``, that was entered since the step before, or
            stands.
        after: So long after that moment [s].
        move, approve, inject, call: Exactly one of them: plan (and have it started), approve the plan under review (``refused``:
            that must be refused, once it was rehearsed), a fault, a service of `Call`.
    """

    when: Annotated[str, pydantic.Field(pattern=r"^(now|motion|rest|(sync|link|execution) [A-Z_]+)$")] = "now"
    after: _NotNegative = 0.0
    move: Move | None = None
    approve: Literal[True, "refused"] | None = None
    inject: Injection | None = None
    call: Call | None = None

    @pydantic.model_validator(mode="after")
    def _one_action(self) -> Step:
        if sum(action is not None for action in (self.move, self.approve, self.inject, self.call)) != 1:
            raise ValueError("exactly one of move, approve, inject and call")
        return self

    def __str__(self) -> str:
        if self.inject:
            subject = self.inject.joint or self.inject.direction
            return f"{self.inject.fault} {subject}".strip() + (" ends" if self.inject.end else "")
        return "move" if self.move else "approve" if self.approve else str(self.call)


class StopBound(StrictModel):
    """From an event (``fault NAME``, ``call NAME``, ``sync STATE``) on the arm moves no further than this [deg]."""

    event: Annotated[str, pydantic.Field(pattern=r"^(fault|call|sync|execution) \S+$")]
    distance_deg: _Positive


class Expectation(StrictModel):
    """The expected outcome; docs/scenarios.md explains every key."""

    sync: list[Annotated[str, pydantic.Field(pattern=r"^[A-Z_]+\??$")]]
    final: Mapping[Literal["sync", "link", "execution", "outcome"], str]
    ends: Literal["goal", "holds"]
    final_error_deg: _Positive = FINAL_ERROR_DEG
    detection_samples: Annotated[int, pydantic.Field(ge=1)] | None = None
    detection_s: _Positive | None = None
    max_error_deg: _Positive | None = None
    min_missed: Annotated[int, pydantic.Field(ge=1)] | None = None
    stop: StopBound | None = None
    refused: str | None = None


class Scenario(StrictModel):
    """A scenario; `limit`: longest that all of it may take, from the first step to the end [s]."""

    name: Annotated[str, pydantic.Field(pattern=r"^[a-z0-9_]+$")]
    title: Annotated[str, pydantic.Field(min_length=1)]
    steps: Annotated[list[Step], pydantic.Field(min_length=1)]
    limit: _Positive = 30.0
    expect: Expectation

    @property
    def goal_deg(self) -> list[float] | None:
        """The last motion's goal [deg], None without one."""
        return next((list(step.move.goal_deg) for step in reversed(self.steps) if step.move), None)

    @property
    def faulted(self) -> frozenset[str]:
        """Joints that a fault keeps off their setpoints."""
        faults = [step.inject for step in self.steps if step.inject]
        return frozenset(fault.joint for fault in faults if fault.fault in ("stall", "slow"))


def make_scenario(name: str, content: object) -> Scenario:
    """Return the scenario that a YAML's key ``scenario`` holds."""
    if not isinstance(content, Mapping):
        raise ScenarioError(f"{name}: the key `scenario` holds {content!r}; expected title, steps, expect")
    try:
        return Scenario.model_validate({"name": name, **content})
    except pydantic.ValidationError as error:
        raise ScenarioError(f"{name}: {wrong_value(error, Scenario.model_json_schema())}") from error
