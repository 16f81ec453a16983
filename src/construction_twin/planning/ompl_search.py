"""OMPL's planners as searches for a path, with each straight motion checked in one call.

OMPL's log and generator of seeds belong to the process: `OmplSearch.find` switches the log off and seeds the generator before every
search, so that one with the same seed gives the same path, unless its planner improves the path until its time is over.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from construction_twin.core.clock import Clock
from construction_twin.core.sentences import Sentence
from construction_twin.planning.motion_validator import MotionValidator
from construction_twin.planning.request_limits import distinct
from construction_twin.robot.motion_errors import PlanningError


class NoPathError(PlanningError):
    """The planner found no path in its time budget [s]."""

    def __init__(self, planner: str, budget: float):
        self.planner, self.budget = planner, budget
        super().__init__(
            Sentence(
                "{planner} found no path within {budget:.3g} s; allow more time or choose another goal",
                planner=planner,
                budget=budget,
            )
        )


#: Distance of the points between which shortcuts are tried: shorter costs more checks and gains little.
SPACING = 1.4
#: A shortcut that gains less than this part of the path's length is not tried.
WORTHWHILE = 0.02


@dataclass(frozen=True)
class PathQuery:
    """The query of a path between free poses within the bounds; it may end at any goal, the nearest first.

    `seed`, 1 to 2**32 - 1, is of everything drawn by chance.
    """

    start: np.ndarray
    goals: Sequence[np.ndarray]
    validator: MotionValidator
    lower: np.ndarray
    upper: np.ndarray
    seed: int


def shortened(path: np.ndarray, is_free: Callable[[np.ndarray, np.ndarray], bool]) -> np.ndarray:
    """Shorten a path between the same ends by the best shortcuts first, until nothing is gained.

    Nothing is drawn by chance. Every edge is a part of a given one, which are free, or was found free by `is_free`.
    """
    points, blocked = _divided(path), set[bytes]()
    while True:
        gains, length = _gains(points)
        firsts, lasts = np.nonzero(gains >= WORTHWHILE * length)
        order = np.argsort(-gains[firsts, lasts], kind="stable")
        for first, last in zip(firsts[order].tolist(), lasts[order].tolist()):
            edge = points[[first, last]]
            key = edge.tobytes()
            if key not in blocked:
                if is_free(*edge):
                    points = np.concatenate((points[:first], _divided(edge), points[last + 1 :]))
                    break
                blocked.add(key)
        else:
            return _fewer(_corners(points), is_free)


def _fewer(points: np.ndarray, is_free: Callable[[np.ndarray, np.ndarray], bool]) -> np.ndarray:
    """Return the path without its avoidable corners, each of which slows the motion."""
    index = 1
    while index < len(points) - 1:
        if is_free(points[index - 1], points[index + 1]):
            points = np.delete(points, index, axis=0)
            index = max(1, index - 1)
        else:
            index += 1
    return points


def _gains(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return by how much the edge between each two points is shorter than the path, shape (m, m), and the path's length."""
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    along = np.concatenate(([0.0], np.cumsum(np.diagonal(apart, 1))))
    return along - along[:, None] - apart, float(along[-1])


def _divided(path: np.ndarray) -> np.ndarray:
    """Return the path with points in between, at most `SPACING` apart."""
    counts = np.ceil(np.linalg.norm(np.diff(path, axis=0), axis=1) / SPACING).astype(int)
    pieces = [a + (np.arange(count) / count)[:, None] * (b - a) for a, b, count in zip(path[:-1], path[1:], counts)]
    return np.concatenate([*pieces, path[-1:]])


def _corners(points: np.ndarray) -> np.ndarray:
    """Return the path without the points between two others that lie on the straight line between them."""
    corners = [0]
    for index in range(1, len(points) - 1):
        before, after = points[index] - points[corners[-1]], points[index + 1] - points[corners[-1]]
        sizes = np.linalg.norm(before) * np.linalg.norm(after)
        if sizes - before @ after > 1e-12 * sizes:
            corners.append(index)
    return points[[*corners, len(points) - 1]]


#: The search itself checks motions with a step so many times as long as what is asked of its path.
COARSER = 4.0


def ompl_planners() -> dict[str, type]:
    """Return OMPL's geometric planners by name."""
    members = ((name, getattr(og, name)) for name in dir(og))
    return {name: kind for name, kind in members if isinstance(kind, type) and issubclass(kind, ob.Planner)}


class _OmplValidator(ob.MotionValidator):
    """`motion_validator.MotionValidator` as OMPL's: one call of Python for a whole motion."""

    def __init__(self, information: ob.SpaceInformation, validator: MotionValidator, joints: range):
        super().__init__(information)
        self._validator = validator
        self._joints = joints

    def checkMotion(self, first, second, *last_valid) -> bool:  # noqa: N802 (OMPL's name)
        """Return whether the straight edge between two states is free."""
        # the last valid state is not filled in; planners that ask for it then reject the whole motion
        return self._validator.free(_values(first, self._joints), _values(second, self._joints))


class OmplSearch:
    """One of OMPL's planners, by its name: finds a path, and shortens it.

    Two kinds are given the first goal only: BFMT, which kills the process where it has several and no path, and the PRM family, of
    which a thread for goals and time would wait for Python for ever, so that it runs on OMPL's clock.
    """

    def __init__(self, name: str, clock: Clock):
        self.name, self._clock = name, clock
        self._kind = ompl_planners()[name]

    def find(self, query: PathQuery, budget: float) -> np.ndarray:
        """Find a path from the start to one of the goals, shape (m, n), or raise NoPathError after a budget [s].

        Neighbouring points differ, both ends are exact, and `query.validator` finds each edge free.
        """
        # few edges of a search are in its path: a search is checked coarsely, its path finely; at a fault it starts again, finely
        for times in (COARSER, 1.0):
            points = self._search(query, query.validator.coarser(times), budget)
            path = shortened(points, query.validator.free)
            if times == 1.0 or all(query.validator.free(*edge) for edge in zip(path, path[1:])):
                break
        return path

    def _search(self, query: PathQuery, validator: MotionValidator, budget: float) -> np.ndarray:
        # without OMPL's log: results and errors are returned, and its warning that a seed was set late concerns only random
        # generators that already exist, of which there are none here
        ou.noOutputHandler()
        ou.RNG.setSeed(query.seed)
        information = _space_information(query, validator)
        end, goals = self._clock() + budget, query.goals
        condition = ob.PlannerTerminationCondition(lambda: self._clock() >= end)
        if issubclass(self._kind, og.PRM):
            condition = ob.timedPlannerTerminationCondition(budget)
        if issubclass(self._kind, (og.PRM, og.BFMT)):
            goals = goals[:1]
        problem = _problem_definition(information, query.start, goals)
        search = self._kind(information)
        search.setProblemDefinition(problem)
        search.setup()
        search.solve(condition)
        if not problem.hasExactSolution():
            raise NoPathError(self.name, budget)
        joints = range(len(query.start))
        found = problem.getSolutionPath().getStates()
        points = np.array([_values(state, joints) for state in found])
        path = points[distinct(points)]
        path[-1] = points[-1]
        return path


def _space_information(query: PathQuery, validator: MotionValidator) -> ob.SpaceInformation:
    joints = range(len(query.start))
    limits = ob.RealVectorBounds(len(joints))
    for joint in joints:
        limits.setLow(joint, float(query.lower[joint]))
        limits.setHigh(joint, float(query.upper[joint]))
    space = ob.RealVectorStateSpace(len(joints))
    space.setBounds(limits)
    information = ob.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: bool(query.validator.world.is_free(_values(state, joints))))
    information.setMotionValidator(_OmplValidator(information, validator, joints))
    information.setup()
    return information


def _problem_definition(
    information: ob.SpaceInformation, start: np.ndarray, goals: Sequence[np.ndarray]
) -> ob.ProblemDefinition:
    problem = ob.ProblemDefinition(information)
    problem.addStartState(_state(information, start))
    targets = ob.GoalStates(information)
    for goal in goals:
        targets.addState(_state(information, goal))
    problem.setGoal(targets)
    return problem


def _state(information: ob.SpaceInformation, q: np.ndarray) -> ob.State:
    state = information.allocState()
    for joint, value in enumerate(q.tolist()):
        state[joint] = value
    return state


def _values(state: ob.State, joints: range) -> np.ndarray:
    return np.array([state[joint] for joint in joints])
