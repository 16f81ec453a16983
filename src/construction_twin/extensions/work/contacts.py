"""Which bodies come close on a straight way on purpose: what a job names as its supports may be touched there, nothing else.

Metres; poses in the robot's base_link. `touch` switches a pair's check off, so `motions` measures how deep such bodies are in each
other, and refuses more than the recipe allows.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import coal
import numpy as np

from construction_twin.kinematics.chain import Pose
from construction_twin.scene.collision_bodies import measured, scene_shapes
from construction_twin.scene.objects import Scene, SceneObject, product
from construction_twin.scene.scene_change import SceneChange

#: Distance between the places of a straight way at which bodies are looked at [m].
STEP = 0.01
#: Way by which what is let go may sink until it lies on something [m]: more than a mortar bed.
FALL = 0.02
#: Part of that way by which it would come deeper into what it lies on already; and a distance that is surely no contact [m].
_SINKS, _CLEAR = 0.3, 1e-4


class ShapeDistances:
    """Distances between objects of scenes, each shape built once."""

    def __init__(self) -> None:
        self._geometries: dict[tuple[str, tuple[float, ...], str], tuple[coal.CollisionGeometry, ...]] = {}

    def near(
        self, moving: Sequence[SceneObject], way: Sequence[Pose], others: Iterable[SceneObject], padding: float
    ) -> tuple[str, ...]:
        """Return the names of standing objects that come within the padding of `moving` ones in a frame on its `way`.

        `way`: at most `STEP` apart and without a turn.
        """
        found = []
        for other in self._around(moving, way, list(others), padding):
            if any(self._comes_near(item, way, other, padding + max(item.padding, other.padding)) for item in moving):
                found.append(other.name)
        return tuple(found)

    def obstruction(self, scene: Scene, base_T_link: Pose) -> tuple[str, str] | None:
        """Return a carried and a standing object that are too close with the arm's tip at a pose, if any."""
        carried = [item for item in scene.objects if item.link]
        standing = [item for item in scene.objects if not item.link]
        for item in carried:
            for other in self._around([item], [base_T_link], standing, scene.padding):
                if other.name in item.touch or {item.name, item.link} & set(other.touch):
                    continue
                margin = scene.padding + max(item.padding, other.padding)
                if self._distance(item, base_T_link, other, margin) <= margin:
                    return item.name, other.name
        return None

    def support_below(
        self, items: Sequence[SceneObject], base_T_frame: Pose, others: Iterable[SceneObject], up: np.ndarray
    ) -> str:
        """Return the name of an object on which items in a frame would come to lie, sinking by `FALL`; empty: they would fall."""
        sunk = Pose(base_T_frame.position - FALL * up, base_T_frame.rotation)
        for other in self._around(items, [base_T_frame, sunk], list(others), FALL):
            solid = not any(isinstance(shape, coal.BVHModelBase) for shape in self._shapes(other))
            for item in items:
                low = self._distance(item, sunk, other, 0.0)
                if low > 0.0:
                    continue
                before = self._distance(item, base_T_frame, other, FALL)
                # how deep something is in a surface nobody can say
                if before > _CLEAR or before - low >= _SINKS * FALL or not solid:
                    return other.name
        return ""

    def _around(
        self, moving: Sequence[SceneObject], way: Sequence[Pose], others: Sequence[SceneObject], padding: float
    ) -> list[SceneObject]:
        """Return the standing objects whose balls come near those of moving ones."""
        balls = [self._ball(other) for other in others]
        middles, radii = np.reshape([middle for middle, _ in balls], (-1, 3)), np.array([radius for _, radius in balls])
        paddings = np.array([other.padding for other in others])
        near = np.zeros(len(others), dtype=bool)
        for item in moving:
            middle, radius = self._ball(item)
            limits = radii + radius + padding + STEP + np.maximum(paddings, item.padding)
            for pose in way:
                apart = middles - (pose.rotation @ middle + pose.position)
                near |= np.linalg.norm(apart, axis=1) <= limits
        return [other for other, is_near in zip(others, near) if is_near]

    def _distance(self, item: SceneObject, base_T_frame: Pose, other: SceneObject, limit: float) -> float:
        """Return the distance of an object in a frame from a standing one; inf if it is surely more than the limit."""
        (middle, radius), (there, other_radius) = self._ball(item), self._ball(other)
        apart = base_T_frame.rotation @ middle + base_T_frame.position - there
        if apart @ apart > (radius + other_radius + limit) ** 2:
            return np.inf
        one, two = _transform(product(base_T_frame, item.pose)), _transform(other.pose)
        return min(
            measured(shape, one, against, two).min_distance
            for shape, against in itertools.product(self._shapes(item), self._shapes(other))
        )

    def _comes_near(self, item: SceneObject, way: Sequence[Pose], other: SceneObject, margin: float) -> bool:
        # between two places nothing comes closer than half of their distance
        limit = margin + 0.5 * STEP
        return any(self._distance(item, pose, other, limit) <= limit for pose in way)

    def _ball(self, item: SceneObject) -> tuple[np.ndarray, float]:
        shapes = self._shapes(item)
        if len(shapes) == 1:
            middle, radius = shapes[0].aabb_center, shapes[0].aabb_radius
        else:
            low = np.min([shape.aabb_local.min_ for shape in shapes], axis=0)
            high = np.max([shape.aabb_local.max_ for shape in shapes], axis=0)
            middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
        return item.pose.rotation @ middle + item.pose.position, radius

    def _shapes(self, item: SceneObject) -> tuple[coal.CollisionGeometry, ...]:
        key = (item.shape, item.size, item.mesh_digest)
        if key not in self._geometries:
            shapes = scene_shapes(item).shapes
            for shape in shapes:
                shape.computeLocalAABB()
            self._geometries[key] = shapes
        return self._geometries[key]


def _transform(pose: Pose) -> coal.Transform3s:
    return coal.Transform3s(pose.rotation, pose.position)


def straight_poses(start: Pose, end: Pose) -> list[Pose]:
    """Return poses on the straight way between two of one orientation, at most `STEP` apart, both included."""
    count = max(1, int(np.ceil(np.linalg.norm(end.position - start.position) / STEP)))
    fractions = np.linspace(0.0, 1.0, count + 1)[:, None]
    positions = start.position + fractions * (end.position - start.position)
    return [Pose(position, start.rotation) for position in positions]


def change_between(before: Scene, after: Scene) -> SceneChange:
    """Return the change that makes one scene of another, which lacks no object of it: it only puts."""
    present = {item.name: item.contents() for item in before.objects}
    return SceneChange(tuple(item for item in after.objects if item.contents() != present.get(item.name)))
