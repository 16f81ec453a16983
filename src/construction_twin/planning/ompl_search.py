"""OMPL's planners as searches for a path, with each straight motion checked in one call.

OMPL's log and its generator of seeds belong to the process, not to a planner. `OmplSearch.find` switches the log off. It seeds the
generator before every search and creates everything that draws random numbers after that, so the same search with the same
seed gives the same path, also in another process. This holds for planners that end with the first path found; a planner that
improves its path until its time is over gets further on a faster machine.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from construction_twin.core.motion_errors import NoPathError
from construction_twin.planning.motion_validator import MotionValidator
from construction_twin.planning.path_search import PathQuery
from construction_twin.planning.path_shortening import shortened

#: The search itself checks motions with a step so many times as long as what is asked of its path.
COARSER = 4.0
#: Points closer than this are one [rad] or [m], per joint.
SAME_POINT = 1e-9


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
    """One of OMPL's planners: finds a path, and shortens it. `path_search.PathSearch` says what comes in and out.

    Planners of the PRM family are given the first goal only: they add goals from a thread of their own, and with a check in Python
    that thread blocks for ever.
    """

    def __init__(self, name: str, kind: type):
        self.name = name
        self._kind = kind

    def find(self, query: PathQuery, budget: float) -> np.ndarray:
        """Find a path from the start to one of the goals; the budget is of OMPL's own clock, shortening comes on top."""
        # most edges of a search are in no path: they are checked coarsely first, and the path that comes of them as asked
        check = query.validator.shortcuts
        for times in (COARSER, 1.0):
            points = self._search(query, query.validator.coarser(times), budget)
            path = shortened(points, check.first_free)
            if times == 1.0 or all(check.free(*edge) for edge in zip(path, path[1:])):
                break
        return path

    def _search(self, query: PathQuery, validator: MotionValidator, budget: float) -> np.ndarray:
        # without OMPL's log: results and errors are returned, and its warning that a seed was set late concerns only random
        # generators that already exist, of which there are none here
        ou.noOutputHandler()
        ou.RNG.setSeed(query.seed)
        information = _space_information(query, validator)
        goals = query.goals[:1] if issubclass(self._kind, og.PRM) else query.goals
        problem = _problem(information, query.start, goals)
        search = self._kind(information)
        search.setProblemDefinition(problem)
        search.setup()
        search.solve(ob.timedPlannerTerminationCondition(budget))
        if not problem.hasExactSolution():
            raise NoPathError(self.name, budget)
        joints = range(len(query.start))
        found = problem.getSolutionPath().getStates()
        return _without_repeats(np.array([_values(state, joints) for state in found]))


def _without_repeats(points: np.ndarray) -> np.ndarray:
    apart = np.max(np.abs(np.diff(points, axis=0)), axis=1) > SAME_POINT
    kept = points[np.concatenate(([True], apart))]
    kept[-1] = points[-1]
    return kept


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


def _problem(information: ob.SpaceInformation, start: np.ndarray, goals: Sequence[np.ndarray]) -> ob.ProblemDefinition:
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
