"""Does the other arm stand in the way of a plan, now or with what it is about to do, and which of the two gives way?

Joint values in rad (m for linear joints), order of the robot's ``joint_names``; times along a plan in s from its start, at
planned speed; points in time in ns.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from construction_twin.plan import Plan
from construction_twin.planning.limit_shares import cycle_times
from construction_twin.robot import RobotModel
from construction_twin.scene.neighbour import Obstacle, row_of
from construction_twin.scene.world import CollisionWorld


@dataclass(frozen=True)
class Conflict:
    """Where a plan meets the other arm.

    Attributes
    ----------
    time : float
        From the present pose until then, at planned speed, at least [s].
    between : tuple of str, length 2
        A link or carried object of ours, and the other arm's.
    """

    time: float
    between: tuple[str, str]


class OwnWay:
    """A plan of ours as a few poses, each with a distance to keep that covers the motion to the next.

    Parameters
    ----------
    plan : Plan
    world : CollisionWorld
        Our robot with what it carries.
    step : float
        Largest way of any point of the arm between two poses that are checked [m].

    Attributes
    ----------
    plan : Plan
    """

    def __init__(self, plan: Plan, world: CollisionWorld, step: float):
        self.plan = plan
        trajectory = plan.trajectory
        times = cycle_times(trajectory)
        self._times = np.append(times[times < trajectory.duration], trajectory.duration)
        self._rows = trajectory.sample_many(self._times)[0]
        self._world = world
        keys, self._half = world.key_rows(self._rows, step)
        self._keys = np.array(keys)
        self._clear: frozenset[Obstacle] = frozenset()

    def row_of(self, q: Iterable[float], start: int = 0) -> int | None:
        """Return the first row from `start` on that a pose belongs to; see `neighbour.row_of`."""
        return row_of(self._rows, q, start)

    def conflict(self, obstacles: Iterable[Obstacle], padding: float, row: int = 0) -> Conflict | None:
        """Return the first contact from a row on, None where the way is free.

        Parameters
        ----------
        obstacles : iterable of Obstacle
            All that the other arm takes up.
        padding : float
            Distance to keep from it [m], on top of the scene's and of what covers the motions between poses. The same every time.
        row : int, optional
            Never less than before.
        """
        obstacles = frozenset(obstacles)
        # what was found out of the way once stays so: our way gets shorter, and what the other arm takes up on its path gets less
        if obstacles <= self._clear:
            return None
        world = self._world.facing(obstacle.padded(padding + self._half) for obstacle in obstacles)
        # the pose before the row covers the way from it
        first = max(0, int(np.searchsorted(self._keys, row, side="right")) - 1)
        keys = self._keys[first:]
        found = world.all_free(self._rows[keys])
        if found is None:
            self._clear = obstacles
            return None
        since = self._times[keys[max(0, found - 1)]] - self._times[row]
        return Conflict(max(0.0, float(since)), world.contact(self._rows[keys[found]]).between)


@dataclass(frozen=True)
class Claim:
    """The right to a way, from the first setpoint of an approved plan until it has ended.

    Attributes
    ----------
    since : int
        Stamp of its first setpoint [ns]; 0: it has not begun.
    name : str
        Of the robot; settles who was first when both began at once.
    """

    since: int
    name: str

    def before(self, other: Claim) -> bool:
        """Return whether this one came first; a plan that has not begun comes after one that has."""
        return (self.since or np.inf, self.name) < (other.since or np.inf, other.name)


def gives_way(conflict: Conflict, own: Claim, other: Claim | None, horizon: float) -> bool:
    """Return whether our plan must not start, or not go on.

    It gives way to an arm that follows no plan, whatever keeps it there; to one whose plan began before ours; and to any when
    the conflict is closer than `horizon`: two arms that both brake cannot meet then.

    Parameters
    ----------
    conflict : Conflict
    own : Claim
    other : Claim or None
        None: the other arm follows no plan.
    horizon : float
        See `braking_horizon` [s].
    """
    return other is None or not own.since or other.before(own) or conflict.time <= horizon


def braking_horizon(robot: RobotModel, other: RobotModel, period: float, delay: float) -> float:
    """Return how far ahead a conflict must be seen [s]: both arms' longest braking times, two looks and the way of the message.

    Parameters
    ----------
    robot, other : RobotModel
    period : float
        Between two looks [s].
    delay : float
        From a look to the first braking setpoint [s].
    """
    braking = (float(np.max(np.divide(one.velocity, one.acceleration))) for one in (robot, other))
    return sum(braking) + 2.0 * period + delay
