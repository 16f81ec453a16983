"""A gateway that follows a curve while its speed is limited."""

from __future__ import annotations

import itertools
import math

from gateway_cell import START, Cell

from construction_twin.core.units import CYCLE, NANOSECONDS, format_allowance

MS = 1_000_000


SECOND = NANOSECONDS


#: A motion of both axes along one curve: A1 and 3 times as much of A2.
RATIO = 3.0


FINE = {"decimals": 6, "silence": 0.5}


#: Cycles after which the motion stands at its start again.
PERIOD = 800


def curve(cycle: float, rate: float = 2 * math.pi / (PERIOD * CYCLE), size: float = 0.3):
    way = size * (1 - math.cos(rate * cycle * CYCLE)) / 2
    return (START[0] + way, START[1] + RATIO * way)


def armed(**changes) -> Cell:
    cell = Cell(**(FINE | changes))
    cell.cycle(3)
    assert cell.arm()[0]
    cell.stream([START] * 10)
    cell.positions = [cell.measured]
    return cell


def play(cell: Cell, poses, limit=None) -> None:
    """Stream poses while the source repeats `limit` at 10 Hz; every position is kept."""
    for k, q in enumerate(poses):
        if limit is not None and k % 25 == 0:
            assert cell.control("speed_limit", value=limit)[0]
        cell.send(q)
        cell.cycle()
        cell.positions.append(cell.measured)


def steps(positions):
    return [[b - a for a, b in zip(*pair)] for pair in itertools.pairwise(positions)]


def assert_within_limits(cell: Cell, positions=None) -> None:
    digit, allowance = math.radians(10.0**-cell.config.decimals), format_allowance(cell.config.decimals)
    moves = [[0.0] * 2, *steps(positions or cell.positions)]
    for axis in range(2):
        assert max(abs(move[axis]) for move in moves) <= cell.config.velocity[axis] * CYCLE + digit + 1e-12
        bends = [abs(b[axis] - a[axis]) for a, b in itertools.pairwise(moves)]
        assert max(bends) <= (cell.config.acceleration[axis] + allowance) * CYCLE**2 + 1e-12


def assert_on_path(cell: Cell, error: float = 3e-8) -> None:
    for a1, a2 in cell.positions:
        assert abs((a2 - START[1]) - RATIO * (a1 - START[0])) < error


def fastest(cell: Cell, since: int, until: int | None = None) -> float:
    """Largest fraction of a velocity limit in a cycle."""
    moves = steps(cell.positions[since:until])
    return max(abs(v) / (limit * CYCLE) for move in moves for v, limit in zip(move, cell.config.velocity))
