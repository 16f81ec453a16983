"""A MuJoCo model of an arm, what it carries and what stands around it, from the records that the planner checks collisions with.

What the planner calls free, the simulation finds free, too. The world is the root of the URDF's tree; SI; joints in the order of
``robot.joint_names``.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import coal
import mujoco
import numpy as np
import pinocchio

from construction_twin.extensions.physics.drive import ArmDrives
from construction_twin.extensions.physics.mass import (
    FRICTION,
    GRAVITY,
    STEP,
    MassProperties,
    check_serial,
    combined,
    of_link,
    of_object,
)
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.scene.collision_bodies import Body, RobotBodies, is_convex, mesh_triangles
from construction_twin.scene.objects import Scene
from construction_twin.scene.pair_checks import checked_pairs
from construction_twin.scene.self_collision import SelfCollision

#: Bodies that touch give way like a spring of this time constant [s] and damping; twice the step is MuJoCo's smallest.
_CONTACT = (0.004, 1.0)


# `arm.is_broken` reads MuJoCo's counters of warnings; without this it would write MUJOCO_LOG.TXT into the present folder
mujoco.set_mju_user_warning(lambda _message: None)


@dataclass(frozen=True, eq=False)
class PhysicsModel:
    """A compiled model and where its numbers are.

    Attributes:
        joints: Shape (n,). Place of each of ``robot.joint_names`` in MuJoCo's arrays.
        owners: Link or scene object of each geom.
        loose: Position of each loose body (`Load.loose`) in MuJoCo's arrays of positions: 7 numbers from there.
        inertias, related: Shape (n, n). Where two joints' inertia is in MuJoCo's sparse matrix, and whether it is there.
        unplanned: Shape (geoms, geoms). Which contacts the planner would have refused.
        payload: What the flange carries, tool and objects, in the frame of the last joint; None: nothing.
        remarks: What is simulated otherwise than the planner checks it, and what is an estimate, one sentence each.
    """

    robot: RobotModel
    model: mujoco.MjModel
    joints: np.ndarray
    drives: ArmDrives
    owners: tuple[str, ...]
    loose: Mapping[str, int]
    inertias: np.ndarray
    related: np.ndarray
    unplanned: np.ndarray
    payload: MassProperties | None
    remarks: tuple[str, ...]

    def at_rest(self, q: JointValues) -> mujoco.MjData:
        """Return a state at rest with the arm at `q`, shape (n,) [rad] or [m]."""
        data = mujoco.MjData(self.model)
        data.qpos[self.joints] = q
        mujoco.mj_forward(self.model, data)
        return data

    def inertia(self, data: mujoco.MjData) -> np.ndarray:
        """Return the mass matrix of the chain with what it carries, shape (n, n) [kg m^2]; motors included."""
        return data.M[self.inertias] * self.related


@dataclass(frozen=True)
class Load:
    """Properties of a scene's objects beside the scene.

    Attributes:
        masses: Of objects, by name [kg]; others are estimated from their volume.
        loose: Body of each object that can be moved or tipped over where it stands, by name. Others are part of the world.
        flange: A payload of which only numbers are known, in the frame of the tip link.
    """

    masses: Mapping[str, float] = field(default_factory=dict)
    loose: Mapping[str, str] = field(default_factory=dict)
    flange: MassProperties | None = None


def build_model(
    bodies: RobotBodies,
    scene: Scene,
    self_collision: SelfCollision,
    drives: ArmDrives,
    load: Load = Load(),
    contacts: bool = True,
) -> PhysicsModel:
    """Compile the model; without `contacts` bodies have masses and no shapes."""
    return _Builder(bodies, scene, self_collision, drives, load, contacts).build()


class _Builder:
    """Builds one model; the order of its steps is that of `build`."""

    def __init__(self, bodies, scene, self_collision, drives, load, contacts):
        check_serial(bodies)
        self._robot_bodies: RobotBodies = bodies
        self._scene: Scene = scene
        self._self_collision: SelfCollision = self_collision
        self._drives: ArmDrives = drives
        self._load: Load = load
        self._contacts: bool = contacts
        self._own = (*bodies.bodies, *bodies.place_all(scene))
        self._remarks: list[str] = []
        self._owners: list[str] = []
        #: Loose bodies, each with the placement of its piece whose name comes first: its frame is there.
        self._loose: dict[str, tuple[mujoco.MjsBody, pinocchio.SE3]] = {}
        self._spec = spec = mujoco.MjSpec()
        spec.modelname = bodies.robot.name
        spec.option.timestep = STEP
        spec.option.gravity = [0.0, 0.0, -GRAVITY]
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.compiler.degree = False
        # which bodies may touch is said pair by pair below
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_FILTERPARENT

    def build(self) -> PhysicsModel:
        """Return the compiled model."""
        model = self._robot_bodies.model
        joints = self._add_arm(model)
        carried = self._add_objects(joints)
        payload = self._add_flange_load(joints, carried)
        self._remarks += self._drives.remarks
        checked = self._checked()
        self._exclude_pairs(checked)
        compiled = self._spec.compile()
        for name, armature, damping, friction in zip(
            self._robot_bodies.robot.joint_names, self._drives.armature, self._drives.damping, self._drives.friction
        ):
            dof = compiled.joint(name).dofadr[0]
            compiled.dof_armature[dof], compiled.dof_frictionloss[dof] = armature, friction
            compiled.dof_damping[dof] = damping
        mujoco.mj_setConst(compiled, mujoco.MjData(compiled))
        dofs = np.array([compiled.joint(name).dofadr[0] for name in self._robot_bodies.robot.joint_names])
        owners = [compiled.geom(geom).name.split("\n")[0] for geom in range(compiled.ngeom)]
        loose = {name: int(compiled.joint(f"free\n{name}").qposadr[0]) for name in self._loose}
        return PhysicsModel(
            self._robot_bodies.robot, compiled, dofs, self._drives, tuple(owners), loose, *_inertias(compiled, dofs),
            _unplanned(owners, checked), payload, tuple(dict.fromkeys(self._remarks)),
        )  # fmt: skip

    def _add_arm(self, model: pinocchio.Model) -> list:
        """Add a body per joint, and return them by Pinocchio's index of the joint; 0 is the world."""
        data = model.createData()
        pinocchio.forwardKinematics(model, data, pinocchio.neutral(model))
        joint_bodies = [self._spec.worldbody]
        for index in range(1, model.njoints):
            placement = model.jointPlacements[index]
            body = joint_bodies[model.parents[index]].add_body(
                name=f"joint\n{model.names[index]}", pos=placement.translation, quat=_quaternion(placement.rotation)
            )
            if not model.parents[index]:
                # an arm that rests inside a plan goes on when the plan does
                body.sleep = mujoco.mjtSleepPolicy.mjSLEEP_NEVER
            axis = np.array(data.joints[index].S, dtype=float).ravel()
            slides = np.any(axis[:3])
            body.add_joint(
                name=model.names[index],
                type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
                axis=axis[:3] if slides else axis[3:],
            )
            inertia, remarks = of_link(self._robot_bodies, index)
            self._remarks += remarks
            _set_mass(body, inertia)
            joint_bodies.append(body)
        for link, shapes in itertools.groupby(self._robot_bodies.bodies, key=lambda one: one.owner):
            pieces = list(shapes)
            # a body of its own per link: pairs are left out link by link
            self._add_geoms(joint_bodies[pieces[0].joint].add_body(name=link), pieces)
        return joint_bodies

    def _add_objects(self, joints: list) -> list[tuple[Body, MassProperties]]:
        """Add the scene's objects, and return those that the arm carries with what they weigh."""
        carried = []
        apart = {name for item in self._scene.objects for name in item.touch} | {
            item.name for item in self._scene.objects if item.touch
        }
        objects = (each for each in self._own if each.item is not None)
        for name, placed in itertools.groupby(objects, key=lambda each: each.owner):
            pieces = list(placed)
            one, properties = pieces[0], of_object(pieces)
            if name in self._load.masses:
                properties = properties.scaled_to(self._load.masses[name])
            if properties.estimated and (one.joint or name in self._load.loose):
                self._remarks.append(f"mass of {name} is an estimate from its volume: {properties.mass:.1f} kg")
            if one.joint:
                holder = joints[one.joint].add_body(
                    name=name, pos=one.placement.translation, quat=_quaternion(one.placement.rotation)
                )
                _set_mass(holder, properties)
                self._add_geoms(holder, pieces, placed=False)
                carried.append((one, properties))
            elif name in self._load.loose:
                self._add_loose(pieces, properties)
            elif name in apart:
                self._add_geoms(self._spec.worldbody.add_body(name=name), pieces)
            else:
                self._add_geoms(self._spec.worldbody, pieces)
        return carried

    def _add_loose(self, pieces: Sequence[Body], properties: MassProperties) -> None:
        """Add one object that can be moved: all objects of a body move as one."""
        one = pieces[0]
        body = self._load.loose[one.owner]
        known = self._loose.get(body)
        if known is None:
            # in every scene the same piece, whatever the order of the objects: states go from one scene to the next
            first = min(
                (
                    each
                    for each in self._own
                    if each.item and not each.joint and self._load.loose.get(each.owner) == body
                ),
                key=lambda each: each.owner,
            ).placement
            whole = self._spec.worldbody.add_body(
                name=f"loose\n{body}", pos=first.translation, quat=_quaternion(first.rotation)
            )
            whole.add_freejoint(name=f"free\n{body}")
            known = self._loose[body] = whole, first
        whole, placement = known
        relative = placement.inverse() * one.placement
        # a body of its own per object: pairs are left out object by object
        piece = whole.add_body(name=one.owner, pos=relative.translation, quat=_quaternion(relative.rotation))
        _set_mass(piece, properties)
        self._add_geoms(piece, pieces, placed=False)

    def _add_flange_load(self, joints: list, carried: list[tuple[Body, MassProperties]]) -> MassProperties | None:
        """Add the mass without a shape, and return all that the last joint carries beside its links, in its frame."""
        tip = self._robot_bodies.robot.tip_link
        frames = self._robot_bodies.model.frames
        frame = frames[self._robot_bodies.model.getFrameId(tip, pinocchio.FrameType.BODY)]
        parts = [properties.at(one.placement) for one, properties in carried if one.joint == frame.parentJoint]
        flange = self._load.flange
        if flange is not None:
            part = flange.at(frame.placement)
            _set_mass(joints[frame.parentJoint].add_body(name="payload\n"), part)
            parts.append(part)
        return combined(parts) if parts else None

    def _add_geoms(self, holder, pieces: Sequence[Body], placed: bool = True) -> None:
        """Add the shapes of a link or an object, with a remark where they are not the planner's, or more than the mesh."""
        if not self._contacts:
            return
        shapes = pieces[0].shapes
        if shapes is not None and shapes.whole is not None:
            self._remarks.append(
                f"the mesh of {pieces[0].owner} is curved: planner and simulation have convex pieces, which "
                f"reach up to {shapes.reach * 1e3:.1f} mm beyond it"
            )
        for one in pieces:
            placement = one.placement if placed else pinocchio.SE3.Identity()
            for geometry in self._touchable(one):
                name = f"{one.owner}\n{len(self._owners)}"
                kind, values = _shape(self._spec, name, geometry)
                holder.add_geom(
                    name=name, type=kind, pos=placement.translation, quat=_quaternion(placement.rotation),
                    contype=1, conaffinity=1, mass=0.0,
                    friction=[FRICTION, 0.005, 0.0001], solref=list(_CONTACT), **values,
                )  # fmt: skip
                self._owners.append(one.owner)

    def _touchable(self, one: Body) -> list[coal.CollisionGeometry | np.ndarray]:
        """Return a shape as MuJoCo takes it: itself, or convex bodies by their corners."""
        geometry = one.geometry
        if isinstance(geometry, coal.BVHModelBase):
            vertices, triangles = mesh_triangles(geometry)
            if not is_convex(vertices, triangles):
                return self._of_surface(one.owner, vertices, triangles)
        elif isinstance(geometry, coal.ConvexBase):
            vertices = np.array(geometry.points(), dtype=float)
        else:
            return [geometry]
        return self._unless_flat(one.owner, vertices)

    def _of_surface(self, owner: str, vertices: np.ndarray, triangles: np.ndarray) -> list[np.ndarray]:
        """Return the corners of convex bodies that hold what the planner has as a surface."""
        # loaded here: most arms and scenes have no such mesh, and manifold3d is tens of MB
        from construction_twin.scene.convex_pieces import convex_pieces  # noqa: PLC0415

        pieces = convex_pieces(vertices, triangles)
        if pieces is None:
            corners = self._unless_flat(owner, vertices)
            if corners:
                self._remarks.append(
                    f"the mesh of {owner} is neither convex nor closed, or too fine to be divided: the simulation "
                    "has its convex hull, so it may find contacts that are none"
                )
            return corners
        self._remarks.append(
            f"the mesh of {owner} is not convex: the simulation has convex pieces, which reach up to "
            f"{pieces.reach * 1e3:.1f} mm beyond it, so it may find contacts that are none"
        )
        return [corners for corners in pieces.corners if not _is_flat(corners)]

    def _unless_flat(self, owner: str, vertices: np.ndarray) -> list[np.ndarray]:
        if _is_flat(vertices):
            self._remarks.append(f"the mesh of {owner} encloses no volume: the simulation leaves it out")
            return []
        return [vertices]

    def _exclude_pairs(self, checked: set[frozenset[str]]) -> None:
        """Leave out the pairs of the arm, and what it carries, that the planner does not check."""
        on_arm = dict.fromkeys(one.owner for one in self._own if one.item is None or one.joint)
        named = {one.owner: one for one in self._own}
        mobile = {name for name in on_arm if named[name].joint}
        # an object may be several pieces: each name once
        standing = dict.fromkeys(
            one.owner for one in self._own if one.item and not one.joint and self._spec.body(one.owner) is not None
        )
        for first, second in itertools.combinations((*on_arm, *standing), 2):
            if (first in mobile or second in mobile) and frozenset((first, second)) not in checked:
                self._spec.add_exclude(bodyname1=first, bodyname2=second)

    def _checked(self) -> set[frozenset[str]]:
        """Return the pairs of owners that the planner checks."""
        return {
            frozenset((self._own[first].owner, self._own[second].owner))
            for first, second, _ in checked_pairs(self._own, self._scene.padding, self._self_collision)
        }


def _unplanned(owners: Sequence[str], checked: set[frozenset[str]]) -> np.ndarray:
    """Return which contacts of geoms are of pairs that the planner checks, shape (geoms, geoms)."""
    geoms: dict[str, list[int]] = {}
    for number, owner in enumerate(owners):
        geoms.setdefault(owner, []).append(number)
    found = np.zeros((len(owners), len(owners)), dtype=bool)
    for first, second in checked:
        for one, other in itertools.product(geoms.get(first, ()), geoms.get(second, ())):
            found[one, other] = found[other, one] = True
    return found


def _inertias(model: mujoco.MjModel, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where the inertias of joints are among those that MuJoCo stores, and which are there.

    It stores, row by row, those of a joint with itself and with the joints that carry it.
    """
    size = len(joints)
    places, related = np.zeros((size, size), dtype=int), np.zeros((size, size), dtype=bool)
    for row, joint in enumerate(joints):
        begin = model.M_rowadr[joint]
        for place in range(begin, begin + model.M_rownnz[joint]):
            (column,) = np.flatnonzero(joints == model.M_colind[place])
            places[row, column] = places[column, row] = place
            related[row, column] = related[column, row] = True
    return places, related


def _shape(
    spec: mujoco.MjSpec, name: str, geometry: coal.CollisionGeometry | np.ndarray
) -> tuple[mujoco.mjtGeom, dict]:
    """Return kind and numbers of a geom: of a shape, or of the hull of corners, shape (k, 3)."""
    kinds = mujoco.mjtGeom
    if isinstance(geometry, coal.Box):
        return kinds.mjGEOM_BOX, {"size": np.array(geometry.halfSide).ravel()}
    if isinstance(geometry, coal.Sphere):
        return kinds.mjGEOM_SPHERE, {"size": [geometry.radius, 0.0, 0.0]}
    if isinstance(geometry, (coal.Cylinder, coal.Capsule)):
        kind = kinds.mjGEOM_CYLINDER if isinstance(geometry, coal.Cylinder) else kinds.mjGEOM_CAPSULE
        return kind, {"size": [geometry.radius, geometry.halfLength, 0.0]}
    spec.add_mesh(name=name, uservert=geometry.ravel().tolist(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
    return kinds.mjGEOM_MESH, {"meshname": name}


def _is_flat(vertices: np.ndarray) -> bool:
    """Return whether corners have no volume that MuJoCo takes."""
    return bool(np.linalg.matrix_rank(vertices - vertices.mean(axis=0), tol=1e-6) < 3)


def _set_mass(body, properties: MassProperties) -> None:
    """Give a body its mass, whatever its shapes."""
    moment = properties.inertia
    body.explicitinertial = True
    body.mass = properties.mass
    body.ipos = properties.centre
    body.fullinertia = [moment[0, 0], moment[1, 1], moment[2, 2], moment[0, 1], moment[0, 2], moment[1, 2]]


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """Return w, x, y, z, as MuJoCo has them."""
    x, y, z, w = pinocchio.Quaternion(rotation).coeffs()
    return np.array([w, x, y, z])
