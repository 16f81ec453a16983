"""Which links of a robot touch each other, and which come close: asked in many poses, on all cores.

What was found about a pair is kept as one of two questions that are still open: whether it is in contact in every pose, and whether
it is close in none. A pair is not asked again once its answer can no longer change, so few pairs are left after the first poses.
The result depends on robot, samples and seed alone: not on the number of processes, nor on how fast they are. Joint values in rad
(m for prismatic joints), distances in m.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
import pinocchio

from construction_twin.robot.description import RobotModel
from construction_twin.scene.collision_bodies import RobotBodies, make_reliable

#: Poses of one piece of work: few enough that a pair whose answer is known is soon left out, many enough that handing them out
#: costs nothing.
_BLOCK = 250
#: Other processes are started when this process alone would need longer for the rest [s]: starting them takes about one.
WORTH_PROCESSES = 2.0

#: Pair of link names.
Pair = tuple[str, str]


@dataclass(frozen=True)
class OpenPairs:
    """The pairs whose answers may still change.

    Attributes:
        always: Pairs that were in contact in every pose so far.
        never: Pairs that were close in no pose so far.
    """

    always: frozenset[Pair]
    never: frozenset[Pair]

    def __and__(self, other: OpenPairs) -> OpenPairs:
        """Return what is open after the poses of both."""
        return OpenPairs(self.always & other.always, self.never & other.never)

    def __bool__(self) -> bool:
        return bool(self.always or self.never)

    @property
    def count(self) -> int:
        """How many pairs are open."""
        return len(self.always | self.never)


class PairSampler:
    """Asks pairs of links in poses that follow from a seed.

    Args:
        pairs: Links that can move against each other.
        near: A pair is close when its distance is at most this [m].
        samples: Poses: the home pose and random ones within the ranges.
    """

    def __init__(self, robot: RobotModel, pairs: Sequence[Pair], near: float, samples: int, seed: int):
        bodies = RobotBodies(robot)
        self._model = bodies.model
        self._geometry = pinocchio.GeometryModel()
        for index, body in enumerate(bodies.bodies):
            shape = pinocchio.GeometryObject(str(index), body.joint, body.placement, body.geometry)
            self._geometry.addGeometryObject(shape)
        wanted = set(pairs)
        #: of each pair of links, the pairs of their shapes
        self._parts: dict[Pair, list[int]] = {}
        for second, other in enumerate(bodies.bodies):
            for first, one in enumerate(bodies.bodies[:second]):
                if (one.link, other.link) in wanted:
                    self._parts.setdefault((one.link, other.link), []).append(len(self._geometry.collisionPairs))
                    self._geometry.addCollisionPair(pinocchio.CollisionPair(first, second))
        self._data = self._model.createData()
        self._contact, self._close = self._geometry.createData(), self._geometry.createData()
        make_reliable(self._contact)
        make_reliable(self._close, [near] * len(self._close.collisionRequests))
        lower, upper = np.array(robot.lower), np.array(robot.upper)
        random = np.random.default_rng(seed).uniform(lower, upper, (samples - 1, len(lower)))
        self._poses = bodies.rows(np.vstack([robot.home, random]))

    def ask(self, start: int, stop: int, pairs: OpenPairs) -> OpenPairs:
        """Return which of `pairs` are still open after the poses from `start` to before `stop`."""
        always = {pair: self._parts[pair] for pair in sorted(pairs.always)}
        never = {pair: self._parts[pair] for pair in sorted(pairs.never)}
        self._choose(never)
        for q in self._poses[start:stop]:
            if not always and not never:
                break
            if never and pinocchio.computeCollisions(self._model, self._data, self._geometry, self._close, q, False):
                results = self._close.collisionResults
                close = [pair for pair, parts in never.items() if any(results[part].isCollision() for part in parts)]
                for pair in close:
                    del never[pair]
                self._choose(never)
            if always:
                pinocchio.updateGeometryPlacements(self._model, self._data, self._geometry, self._contact, q)
                for pair in [pair for pair, parts in always.items() if not any(map(self._touch, parts))]:
                    del always[pair]
        return OpenPairs(frozenset(always), frozenset(never))

    def _touch(self, part: int) -> bool:
        return pinocchio.computeCollision(self._geometry, self._contact, part)

    def _choose(self, pairs: dict[Pair, list[int]]) -> None:
        """Look only for these pairs when asking which are close."""
        chosen = {part for parts in pairs.values() for part in parts}
        for part in range(len(self._geometry.collisionPairs)):
            if part in chosen:
                self._close.activateCollisionPair(part)
            else:
                self._close.deactivateCollisionPair(part)


def sample_pairs(
    robot: RobotModel,
    pairs: Sequence[Pair],
    near: float,
    samples: int,
    seed: int,
    processes: int = 1,
    report: Callable[[int, int], None] = lambda poses, pairs: None,
    worth: float = WORTH_PROCESSES,
    clock: Callable[[], float] = time.monotonic,
) -> OpenPairs:
    """Ask all pairs in all poses.

    Args:
        robot, pairs, near, samples, seed: As of `PairSampler`.
        processes: At most so many processes work at the same time. Started by `spawn`, so a program that calls this must not do so
            while it is imported.
        report: Called with the number of poses done and of pairs still open, after every piece of work.
        worth: Other processes are started when this one would need longer than this for the rest [s].
        clock: Returns seconds; only decides whether other processes are started.

    Returns:
        `always`: in contact in every pose; `never`: close in none.
    """
    sampler = PairSampler(robot, pairs, near, samples, seed)
    found = OpenPairs(frozenset(pairs), frozenset(pairs))
    blocks = [(start, min(start + _BLOCK, samples)) for start in range(0, samples, _BLOCK)]
    while blocks and found:
        began = clock()
        start, stop = blocks.pop(0)
        found = sampler.ask(start, stop, found)
        report(stop, found.count)
        if processes > 1 and (clock() - began) * len(blocks) > worth and start:
            found = _on_processes((robot, tuple(pairs), near, samples, seed), blocks, found, processes, report)
            break
    report(samples, found.count)
    return found


def _on_processes(
    arguments: tuple,
    blocks: Sequence[tuple[int, int]],
    found: OpenPairs,
    processes: int,
    report: Callable[[int, int], None],
) -> OpenPairs:
    """Ask what is open in the poses of the blocks, on several processes."""
    waiting, running = list(reversed(blocks)), set[Future]()
    done = blocks[0][0]
    sizes: dict[Future, int] = {}
    pool = ProcessPoolExecutor(min(processes, len(blocks)), get_context("spawn"), _start_worker, arguments)
    try:
        while found and (waiting or running):
            # one piece more than there are processes, so that none waits; not all of them, so that each is told what is still open
            while waiting and len(running) <= processes:
                start, stop = waiting.pop()
                future = pool.submit(_work, start, stop, found)
                sizes[future] = stop - start
                running.add(future)
            finished, running = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                found &= future.result()
                done += sizes.pop(future)
            report(done, found.count)
    finally:
        pool.shutdown(cancel_futures=True)
    return found


#: In another process: its sampler.
_worker: PairSampler | None = None


def _start_worker(robot: RobotModel, pairs: Sequence[Pair], near: float, samples: int, seed: int) -> None:
    global _worker
    # Ctrl-C reaches every process of the terminal: the first one ends the others, without their tracebacks
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _worker = PairSampler(robot, pairs, near, samples, seed)


def _work(start: int, stop: int, pairs: OpenPairs) -> OpenPairs:
    assert _worker is not None
    return _worker.ask(start, stop, pairs)
