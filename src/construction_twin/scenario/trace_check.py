"""Whether what the gateway really sent lies inside the limits: a check of its trace, cycle by cycle. Standard library only; rad.

It judges what arrives at the controller: a reply that did not is left out, by what the next telegram said of it. That HOLDON stops
the arm then is the network's doing; what comes after it is the gateway's.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from construction_twin.core.limits import RANGE_SLACK, MotionLimits
from construction_twin.core.units import CYCLE
from construction_twin.gateway.states import State
from construction_twin.gateway.trace import TraceEntry

#: Room for the last bits of differences of floating point numbers, as a fraction of a limit.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Excess:
    """A cycle in which a limit was left.

    Attributes:
        index: Of the entry.
        ipoc: [ms]
        kind: ``range``, ``velocity`` or ``acceleration``.
        value, limit: [rad], [rad/s] or [rad/s^2]; the limit with the format's allowance.
    """

    index: int
    ipoc: int
    axis: str
    kind: str
    value: float
    limit: float

    def __str__(self) -> str:
        return f"entry {self.index}, IPOC {self.ipoc}: {self.axis} {self.kind} {self.value:.6g}; limit {self.limit:.6g}"


#: States in which the gateway adds nothing to what the controller's own program does.
_LED = (State.MEASURING, State.OTHER_CYCLE, State.READY, State.ARMED)


def trace_excesses(
    entries: Iterable[TraceEntry], limits: MotionLimits, decimals: int, cycle: float = CYCLE
) -> list[Excess]:
    """Return every place where a trace leaves the limits; empty when it stays inside.

    Each reply is one step from the last one that arrived. A controller session begins at rest; so does what follows a cycle without
    a reply, because HOLDON has stopped the arm.

    Args:
        limits: Of the axes, in the trace's order.
        decimals: Decimals on the wire; velocity and acceleration are allowed what their rounding adds.
        cycle: The controller's cycle [s].
    """
    allowances = limits.allowances(decimals, cycle)
    velocity = [v + allowance * cycle / 2 for v, allowance in zip(limits.velocity, allowances)]
    acceleration = [a + allowance for a, allowance in zip(limits.acceleration, allowances)]
    rest = (0.0,) * len(limits.names)
    found: list[Excess] = []
    last: TraceEntry | None = None
    kept: TraceEntry | None = None
    step = rest
    for index, entry in enumerate(entries):
        if last is None or entry.session != last.session:
            last, kept, step = entry, None, rest
        elif entry.time_since(last) > round(cycle * 1000):
            step = rest
        if entry.lost and kept is not None:
            last, step = kept, rest
        new = tuple([q - before for q, before in zip(entry.position, last.position)])
        if entry.state in _LED:
            # the pose follows the controller's own motion: what it does, and what it does in a missed cycle, is not the gateway's
            new = step = rest
        for axis, q in enumerate(entry.position):
            name = limits.names[axis]
            if not limits.lower[axis] - RANGE_SLACK <= q <= limits.upper[axis] + RANGE_SLACK:
                end = limits.upper[axis] if q > limits.upper[axis] else limits.lower[axis]
                found.append(Excess(index, entry.ipoc, name, "range", q, end))
            speed = new[axis] / cycle
            if abs(speed) > velocity[axis] * (1 + _ROUNDING):
                found.append(Excess(index, entry.ipoc, name, "velocity", speed, velocity[axis]))
            change = (new[axis] - step[axis]) / cycle**2
            if abs(change) > acceleration[axis] * (1 + _ROUNDING):
                found.append(Excess(index, entry.ipoc, name, "acceleration", change, acceleration[axis]))
        kept, last, step = last, entry, new
    return found
