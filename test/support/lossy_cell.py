"""A gateway whose telegrams and replies are lost on the way, in front of a controller that holds and counts as docs/rsi.md says."""

from __future__ import annotations

import itertools

from gateway_cell import Cell


class LossyCell(Cell):
    """A `Cell` whose network loses what it is told to.

    Args:
        cumulative: Bool. `Delay` counts all missed cycles of the session; False: those in a row.

    Attributes:
        tells_delay: False: telegrams have no `Delay`.
        arrived: Every correction that arrived, as a position [rad], with the number of its cycle.
    """

    def __init__(self, cumulative=False, **changes):
        super().__init__(**changes)
        self.tells_delay = True
        self.arrived = []
        self.number = 0
        self._cumulative = cumulative
        self._losses = ""

    def lose(self, losses):
        """Lose something in the next cycles: ``r`` a reply, ``t`` a telegram, anything else nothing."""
        self._losses += losses

    def telegram(self, **changes):
        loss, self._losses = self._losses[:1], self._losses[1:]
        self.number += 1
        held = self.measured
        reply = None
        if loss != "t":
            reply = super().telegram(**({} if self.tells_delay else {"missed": None}) | changes)
        if reply is None or loss == "r":
            self.measured = held
            self.delay += 1
        else:
            self.arrived.append((self.number, self.measured))
            self.delay = self.delay if self._cumulative else 0
        return reply


def steps_of(arrived):
    """Return the step of each cycle in which something arrived, and that of the cycle before, 0 where HOLDON held the arm."""
    moves = []
    for (before, start), (number, end) in itertools.pairwise(arrived):
        step = tuple(b - a for a, b in zip(start, end))
        last = moves[-1][0] if moves and number == before + 1 else (0.0,) * len(step)
        moves.append((step, last))
    return moves


def assert_arrived_within_limits(cell):
    """Every correction that arrived is inside the limits against the one that arrived before it, from rest after a missed cycle."""
    config, period = cell.config, cell.config.period
    allowances = config.limits.allowances(config.decimals, period)
    lower, upper = config.limits.lower, config.limits.upper
    for number, (step, last) in enumerate(steps_of(cell.arrived), 1):
        for axis, allowance in enumerate(allowances):
            speed, change = abs(step[axis]) / period, abs(step[axis] - last[axis]) / period**2
            where = f"axis {axis} in cycle {cell.arrived[number][0]}"
            assert speed <= config.limits.velocity[axis] + allowance * period / 2 + 1e-9, (where, "velocity", speed)
            assert change <= config.limits.acceleration[axis] + allowance + 1e-6, (where, "acceleration", change)
            assert lower[axis] - 1e-9 <= cell.arrived[number][1][axis] <= upper[axis] + 1e-9, where
