"""The branches of an arm on a linear axis, solved at positions all along the axis at once.

Evenly spaced positions are enough, except where joints 1 to 3 move fast: at the edges of the reach, and where the wrist centre
passes axis 1. Positions are added there. Between two neighbouring positions of a branch is an interval; `rail_search` looks into
those that may hold the nearest solution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from construction_twin.kinematics.closed_form import SLOTS, ClosedFormInverse
from construction_twin.kinematics.rail_intervals import Aim, Node, make_node
from construction_twin.kinematics.rail_rates import RailRates
from construction_twin.kinematics.ranges import TURN

#: Number of evenly spaced positions along the axis; and where it is not level, so that the edges of the reach are not known.
_POSITIONS, _OBLIQUE = 31, 151
#: Where the wrist centre passes axis 1 more closely than the first [m], positions are added where joint 1 has turned by these
#: angles [rad]; not closer than the last [m].
_PASSING, _TURNS, _CLOSEST = 0.2, np.tan([-1.3, -0.8, 0.0, 0.8, 1.3]), 1e-6
#: Joints 2 and 3 further out of range than this at both ends of an interval are so between them [rad].
_FAR = 0.15
#: A wrist that comes closer to singular than this counts as exactly singular: only the sum of joints 4 and 6 is given [rad]. Beside
#: such a position the arm is solved this far away [m].
SINGULAR, ASIDE = 4e-7, 1e-6
#: The branches with the wrist turned over follow those without, so many.
_WRIST = len(SLOTS) // 2


@dataclass(frozen=True, eq=False)
class Samples:
    """The arm's branches at positions along the axis.

    Samples are numbered branch by branch, in the order of `SLOTS`, those of a branch along the axis.

    Attributes:
        flange: Shape (4, 4). The target as `ClosedFormInverse.flange` gives it, with the carriage at zero.
        positions: Shape (m,). Ascending [m].
        q: Shape (6, 8 m). Of each sample [rad]; nan where the branch is missing or not wanted.
        joined: Shape (8 m + 1,), true or false. Which samples bound an interval with the one before; the last number stands for no
            sample.
        wrist: Length 8. |sin| of each branch's wrist angle at the given position; nan where a branch is missing.
        singular: Positions where the wrist is exactly singular [m], as far as found.
        edges: Positions just within an edge of a shoulder's reach [m].
        edges_known: No branch ends within an interval.
    """

    flange: np.ndarray
    positions: np.ndarray
    q: np.ndarray
    joined: np.ndarray
    wrist: list[float]
    singular: list[float]
    edges: list[float]
    edges_known: bool


@dataclass(frozen=True, eq=False)
class Measured:
    """Samples with respect to an aim.

    Attributes:
        away: Shape (7, k). Distance of position [m] and joints [rad] from the seed, with the nearest whole turns within the ranges.
        nearest: Shape (7, k). The same with the nearest whole turns even where they are out of range.
        squares: Shape (k,). Squared distance; nan where a branch is missing.
        excess: Shape (k,). By how much the worst joint is out of range [rad].
        moved: Shape (k,), true or false. Whether the nearest turns are out of range.
    """

    away: np.ndarray
    nearest: np.ndarray
    squares: np.ndarray
    excess: np.ndarray
    moved: np.ndarray


class RailSampler:
    """Solves an arm at positions along the axis that carries it.

    Args:
        arm: The six joints on the carriage.
        travel: Shape (3,). Direction in which the carriage travels, in the directions of the arm's model.
        low, high: The carriage's range [m].
    """

    def __init__(self, arm: ClosedFormInverse, travel: np.ndarray, low: float, high: float):
        self._arm, self._along = arm, RailRates(arm.model, travel)
        self._travel = travel
        self._low, self._high = low, high
        self._even = np.linspace(low, high, _POSITIONS if self._along.level else _OBLIQUE)
        robot = arm.chain.robot
        self._lower, self._upper = np.array(robot.lower)[:, None], np.array(robot.upper)[:, None]
        # of joints 2 and 3: middle of the range, and half of it with a margin
        self._middle = (0.5 * (self._lower + self._upper))[1:3, 0]
        self._half = (0.5 * (self._upper - self._lower))[1:3, 0] + _FAR
        self._endless = ((self._upper - self._lower)[:, 0] >= TURN).tolist()
        signs = arm.model.signs
        self._sense = float(signs[3] * signs[5])
        self._straight = signs[4] * arm.model.offsets[4]

    def sample(self, flange: np.ndarray, position: float, wanted: np.ndarray | None = None) -> Samples:
        """Return the branches at evenly spaced positions, at a given one, and at those that `rail_rates` names.

        Args:
            flange: Shape (4, 4). As in `Samples`.
            position: [m]
            wanted: Shape (8,), true or false. Which branches. Default: all.
        """
        edges, at_axis = self._along.steep_positions(flange)
        edges = [edge for edge in edges if self._low < edge < self._high]
        more = [position, *edges]
        if at_axis is not None and at_axis[1] < _PASSING:
            more += (at_axis[0] + max(at_axis[1], _CLOSEST) * _TURNS).tolist()
        positions = np.concatenate([self._even, more])
        np.minimum(np.maximum(positions, self._low, out=positions), self._high, out=positions)
        positions.sort()
        q, wrist, lost = self._solve(flange, positions)
        here = wrist[int(positions.searchsorted(position))].tolist()
        singular = []
        if lost is not None:
            singular = positions[lost].tolist()
            beside = [each + aside for each in singular for aside in (-ASIDE, ASIDE)]
            positions = np.sort(np.clip(np.concatenate([positions[~lost], beside]), self._low, self._high))
            q, wrist, _ = self._solve(flange, positions)
        # joints 2 and 3 do not depend on how the wrist is turned, and they have less than one turn
        two = q[:, :_WRIST, 1:3] - self._middle
        two -= TURN * np.rint(two * (1.0 / TURN))
        in_range = np.abs(two, out=two) < self._half
        near = (in_range[:, :, 0] & in_range[:, :, 1]).T
        counts = near[:, 1:] | near[:, :-1]
        if at_axis is not None:
            # all edges of the reach are among the positions: between a position on a branch and one that is not, there is nothing
            exists = (wrist[:, :_WRIST] >= 0.0).T
            counts &= exists[:, 1:]
            counts &= exists[:, :-1]
        joined = np.zeros(len(SLOTS) * len(positions) + 1, dtype=bool)
        by_branch = joined[:-1].reshape(2, _WRIST, -1)
        by_branch[:, :, 1:] = counts
        rows = q.transpose(2, 1, 0).copy()
        if wanted is not None:
            by_branch.reshape(len(SLOTS), -1)[~wanted] = False
            rows[:, ~wanted] = math.nan
        return Samples(flange, positions, rows.reshape(6, -1), joined, here, singular, edges, at_axis is not None)

    def aim(self, seed: np.ndarray, turns: Sequence[int] | None = None) -> Aim:
        """Return what to search for.

        Args:
            seed: Shape (7,). Near which: position [m] and joints [rad], within the ranges.
            turns: Length 6. By how many whole turns to be further than the nearest one, for joints that have more than one.
                Default: with the nearest turns within the ranges.
        """
        low, high = (self._lower[:, 0] - seed[1:]).tolist(), (self._upper[:, 0] - seed[1:]).tolist()
        if turns is not None:
            for joint, (endless, turn) in enumerate(zip(self._endless, turns)):
                if endless:
                    low[joint] = max(low[joint], (turn - 0.5) * TURN)
                    high[joint] = min(high[joint], (turn + 0.5) * TURN)
        return Aim(seed, turns, low, high)

    def measure(self, samples: Samples, aim: Aim) -> Measured:
        """Return samples with respect to an aim."""
        away = np.empty((7, samples.q.shape[1]))
        away[0].reshape(len(SLOTS), -1)[:] = samples.positions - aim.seed[0]
        joints = away[1:]
        np.subtract(samples.q, aim.seed[1:, None], out=joints)
        joints -= TURN * np.rint(joints * (1.0 / TURN))
        if aim.turns is not None:
            joints += TURN * np.array(aim.turns)[:, None]
        nearest = away.copy()
        # the seed is in range, so besides the nearest turn only the next one towards the range can be in it; out of range, the one
        # that is out by less, so that nothing jumps where the range ends
        for row, low, high, endless in zip(joints, aim.low, aim.high, self._endless):
            both = low + high
            if endless and aim.turns is not None:
                continue
            if high < 0.5 * TURN and both < 0.0:
                row -= TURN * (row > max(high, 0.5 * (both + TURN)))
            elif -low < 0.5 * TURN and both > 0.0:
                row += TURN * (row < min(low, 0.5 * (both - TURN)))
        squares = np.einsum("ij,ij->j", away, away)
        ends = np.array([aim.low, aim.high])[:, :, None]
        middle, half = 0.5 * (ends[1] + ends[0]), 0.5 * (ends[1] - ends[0])
        excess = (np.abs(joints - middle) - half).max(axis=0)
        excess[np.isnan(squares)] = math.inf
        return Measured(away, nearest, squares, excess, (nearest != away).any(axis=0))

    def straight(self, aim: Aim) -> tuple[float, float]:
        """Return where axes 4 and 6 are in line, as `rail_intervals.make_intervals` takes it."""
        return self._straight - float(aim.seed[5]), self._sense

    def sample_node(self, samples: Samples, measured: Measured, column: int, nearest: bool, aim: Aim) -> Node:
        """Return a sample as a node, with the turns of `Measured.nearest` or of `Measured.away`."""
        away = (measured.nearest if nearest else measured.away)[:, column].tolist()
        rates = self._along.rates(samples.q[:, column].tolist())
        return make_node(away, rates, aim, samples.positions[column % len(samples.positions)] in samples.edges)

    def flanges(self, flange: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Return targets as the arm sees them from positions, shape (m, 4, 4); `flange` is the one from position zero."""
        flanges = np.empty((len(positions), 4, 4))
        flanges[:] = flange
        flanges[:, :3, 3] -= positions[:, None] * self._travel
        return flanges

    def _solve(self, flange: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return branches, |sin| of their wrist angles, and at which positions one is lost because its wrist is exactly singular.

        The last is None if there is no such position.
        """
        q, wrist, _ = self._arm.branches(self.flanges(flange, positions))
        missing = np.isnan(wrist)
        # neighbours differ in the elbow, which does not decide about the reach: where one is missing, its wrist is the reason
        lost = missing[:, ::2] != missing[:, 1::2]
        lost |= (wrist < SINGULAR)[:, ::2] | (wrist < SINGULAR)[:, 1::2]
        return q, wrist, lost.any(axis=1) if lost.any() else None

    def node(
        self, flange: np.ndarray, position: float, slot: int, expected: Sequence[float], aim: Aim
    ) -> tuple[Node, bool]:
        """Return a branch at a position, with turns nearest to the expected ones, and whether its wrist is exactly singular."""
        q, wrist, _ = self._arm.branches(self.flanges(flange, np.array([position])))
        joints, angle = q[0, slot].tolist(), float(wrist[0, slot])
        away = [position - float(aim.seed[0])]
        for value, near, guess in zip(joints, aim.seed[1:].tolist(), expected[1:]):
            value -= near
            away.append(value - TURN * round((value - guess) / TURN) if value == value else value)
        singular = angle < SINGULAR or (angle != angle and not math.isnan(wrist[0, slot ^ 1]))
        return make_node(away, self._along.rates(joints), aim), singular
