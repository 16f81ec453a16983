"""Another arm as an obstacle: its shapes where it stands, and along the path of a plan.

A path is represented by padded copies of each body, two successive ones at most `STEP` apart by the longest path of any of its
points: every pose between them is within half of that of one of the two. Metres; poses in the root of the URDF of the robot that
must not touch them; joint values in the order of the other robot's ``joint_names``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import coal
import numpy as np
import pinocchio
import pydantic

from construction_twin.core.errors import ConfigurationError
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import RobotModel
from construction_twin.robot.frames import rpy_to_rotation
from construction_twin.scene.collision_bodies import Body, RobotBodies
from construction_twin.scene.distance_bounds import body_levers
from construction_twin.scene.objects import SceneObject, relative
from construction_twin.validation import StrictModel, wrong_value

_Metres = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=-1e4, le=1e4)]
_Degrees = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=-360.0, le=360.0)]


class _Place(StrictModel):
    xyz: tuple[_Metres, _Metres, _Metres]
    rpy_deg: tuple[_Degrees, _Degrees, _Degrees]


@dataclass(frozen=True)
class Cell:
    """Robots and where they stand: ``world_T_root`` of each one's URDF, by the robot's name."""

    places: Mapping[str, Pose]

    def world_T_root(self, robot: str) -> Pose:  # noqa: N802 (a transform's name)
        """Return where a robot stands."""
        if robot not in self.places:
            raise ConfigurationError("the cell's robots", sorted(self.places), f"one named {robot!r}")
        return self.places[robot]

    def root_T_root(self, robot: str, other: str) -> Pose:  # noqa: N802 (a transform's name)
        """Return where another robot stands, seen from a robot; raises like `world_T_root`."""
        return relative(self.world_T_root(robot), self.world_T_root(other))


_PLACES = pydantic.TypeAdapter(dict[str, _Place])


def load_cell(description: object) -> Cell:
    """Build a cell from a parsed YAML file, see config/cell_two_robots.yaml."""
    try:
        places = _PLACES.validate_python(description)
    except pydantic.ValidationError as error:
        wrong = wrong_value(error, _PLACES.json_schema())
        raise ConfigurationError("/".join(filter(None, ("cell", wrong.key))), wrong.value, wrong.expected) from error
    return Cell({name: Pose(np.array(place.xyz), rpy_to_rotation(place.rpy_deg)) for name, place in places.items()})


#: Longest path of any point of a body between two copies of it [m]. Small: tighter around the path, but more shapes and slower
#: planning.
STEP = 0.2
#: Added to every copy's padding [m]: between two 4 ms samples of a path a joint may move back and forth by 2e-5 rad.
ROUNDING = 1e-3
#: An arm whose joints have moved no further stands still [rad] or [m]: no point of it has moved further than `ROUNDING`.
STILL = 2e-5
#: Poses that stand for the motion from the measured to the commanded pose.
_BETWEEN = 20


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A copy of a body of the other arm, ``<robot>/<link or carried object>``, and the distance to keep from it [m]."""

    owner: str
    placement: pinocchio.SE3
    geometry: coal.CollisionGeometry
    padding: float = 0.0

    @cached_property
    def distance(self) -> float:
        """Lower bound of its distance from the root of our URDF, without the padding [m]; may be negative."""
        self.geometry.computeLocalAABB()
        centre = self.placement.act(np.array(self.geometry.aabb_center))
        return float(np.linalg.norm(centre)) - float(self.geometry.aabb_radius)

    def padded(self, padding: float) -> Obstacle:
        """Return the same body with a padding that is larger by this [m]."""
        return replace(self, padding=self.padding + padding)


class Neighbour:
    """Another robot; `own_root_T_root`: its URDF's root in that of ours, see `Cell.root_T_root`."""

    def __init__(self, name: str, robot: RobotModel, own_root_T_root: Pose):
        self.name = name
        self._robot_bodies = RobotBodies(robot)
        self._own_root_T_root = pinocchio.SE3(own_root_T_root.rotation, own_root_T_root.position)
        self._set_bodies(self._robot_bodies.bodies)

    def carrying(self, items: Iterable[SceneObject]) -> Neighbour:
        """Return the same robot with what its links carry; objects that stand in the world are left out."""
        items = tuple(items)
        names = [item.name for item in items]
        other = object.__new__(Neighbour)
        other.__dict__.update(self.__dict__)
        carried = (body for item in items if item.link for body in self._robot_bodies.place(item, names))
        other._set_bodies((*self._robot_bodies.bodies, *carried))
        return other

    def _set_bodies(self, bodies: tuple[Body, ...]) -> None:
        self._bodies = bodies
        self._standing: tuple[np.ndarray, tuple[Obstacle, ...]] | None = None
        self._levers, _ = body_levers(self._robot_bodies, bodies, self._robot_bodies.strokes)

    def space_along(self, path: np.ndarray) -> tuple[Obstacle, ...]:
        """Return the space that the arm occupies on a path, shape (m, n), between whose rows (4 ms) it moves within `ROUNDING`."""
        rows = self._robot_bodies.rows(np.atleast_2d(np.asarray(path, dtype=float)))
        steps = np.abs(np.diff(rows, axis=0)) @ self._levers
        travel = np.vstack([np.zeros(len(self._bodies)), np.cumsum(steps, axis=0)])
        keys = [key_rows(column, STEP) for column in travel.T]
        copies: list[Obstacle] = []
        for index, (body, placements) in enumerate(zip(self._bodies, self._placements(rows, keys))):
            gaps = np.diff(travel[keys[index], index], prepend=0.0, append=travel[-1, index])
            # a single copy must cover the whole path, not only half of it
            paddings = np.maximum(gaps[:-1], gaps[1:]) / (2.0 if len(placements) > 1 else 1.0) + ROUNDING
            if body.item is not None:
                paddings += body.item.padding
            owner = f"{self.name}/{body.owner}"
            copies += [Obstacle(owner, place, body.geometry, float(more)) for place, more in zip(placements, paddings)]
        return tuple(copies)

    def space_between(self, start: Iterable[float], end: Iterable[float]) -> tuple[Obstacle, ...]:
        """Return the space that the arm occupies at two poses and on the straight joint motion between them.

        For an arm whose measured pose lags behind its command: it may be anywhere between the two.
        """
        ends = np.array((tuple(start), tuple(end)), dtype=float)
        # within noise that the padding covers, the same objects are returned, so that callers need not check them again
        if self._standing is None or np.abs(ends - self._standing[0]).max() > STILL:
            path = ends[0] + np.linspace(0.0, 1.0, _BETWEEN)[:, None] * (ends[1] - ends[0])
            self._standing = ends, tuple(item.padded(ROUNDING) for item in self.space_along(path))
        return self._standing[1]

    def _placements(self, rows: np.ndarray, keys: list[list[int]]) -> list[list[pinocchio.SE3]]:
        """Return the placements of each body at the rows selected for it."""
        model = self._robot_bodies.model
        data = model.createData()
        wanted: dict[int, list[int]] = {}
        for index, found in enumerate(keys):
            for row in found:
                wanted.setdefault(row, []).append(index)
        placements: list[list[pinocchio.SE3]] = [[] for _ in keys]
        for row in sorted(wanted):
            pinocchio.forwardKinematics(model, data, rows[row])
            for index in wanted[row]:
                body = self._bodies[index]
                placements[index].append(self._own_root_T_root * data.oMi[body.joint] * body.placement)
        return placements


def key_rows(travel: np.ndarray, step: float) -> list[int]:
    """Return rows about a step apart by the distance travelled to each, shape (m,) [m]: the first, the last, and between.

    Only the first row if the whole distance is at most `ROUNDING`.
    """
    total = float(travel[-1])
    if total <= ROUNDING:
        return [0]
    targets = np.linspace(0.0, total, 1 + int(np.ceil(total / step)))
    rows = np.searchsorted(travel, targets[1:-1] + 1e-12, side="right") - 1
    return np.unique([0, *rows, len(travel) - 1]).tolist()
