"""A robot's links and a scene's objects as shapes of Pinocchio and Coal; metres, poses in the root of the URDF's tree."""

from __future__ import annotations

import hashlib
import itertools
import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio

from construction_twin.core.errors import ConfigurationError
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.motion_errors import SceneError
from construction_twin.robot.packages import with_mesh_files
from construction_twin.scene.mesh_file import parse_mesh, surface
from construction_twin.scene.objects import Scene, SceneObject, names_text, read_mesh_file

#: A closed mesh is convex when no vertex lies further outside one of its faces than this fraction of its size.
_CONVEX_TOLERANCE = 1e-6
#: Coal decides whether convex shapes touch within this [m]; then it measures their depth, within 1e-6 m. With its default, 1e-6 as
#: well, it calls shapes that are up to 1e-6 m apart touching, and their depth comes out as infinite, or metres: of 100,000 pairs of
#: boxes edge to edge 325 (Coal 3.0.3); with 1e-8 none.
_GJK_TOLERANCE = 1e-8
#: A distance below this is Coal's word for a depth that it could not measure [m].
UNKNOWN = -1e300
#: By so much a shape is moved to measure what could not be measured [m].
_ASIDE = (1e-6, 1e-5, 1e-4)
#: Range of a joint of Pinocchio's model where it has no effect [rad] or [m].
_NO_LIMIT = 1e3
#: Smallest and largest extent of a mesh that is part of an arm [m]: beyond, its unit or its scale is wrong.
_SMALLEST, _LARGEST = 1e-3, 50.0
#: Most meshes of scene objects that are kept for the next scene.
_MESHES_KEPT = 4096
#: Pieces that reach further beyond their mesh would keep the arm out of what is free: [m], and as a fraction of the mesh's size.
_FARTHEST, _FARTHEST_SHARE = 0.005, 0.025


@dataclass(frozen=True)
class Body:
    """One shape, rigidly fixed to a joint.

    Attributes:
        link: The link it belongs to or is carried by; "": it stands in the world.
        joint: Pinocchio's index; 0: nothing moves it.
        placement: In the joint's frame.
        item, shapes: Of a scene object: itself, and all its shapes.
    """

    owner: str
    link: str
    joint: int
    placement: pinocchio.SE3
    geometry: coal.CollisionGeometry
    item: SceneObject | None = None
    shapes: ObjectShapes | None = None


@dataclass(frozen=True, eq=False)
class ObjectShapes:
    """A scene object for contacts, in its frame: one shape, or convex pieces that reach beyond its mesh by `reach` [m].

    `whole`: the surface that has the object's volume and moments; None: its shapes have them, together.
    """

    shapes: tuple[coal.CollisionGeometry, ...]
    reach: float = 0.0
    whole: coal.CollisionGeometry | None = None


class RobotBodies:
    """A robot's joints and collision shapes; joints outside of the chain are locked, or follow one of the chain.

    Attributes:
        order: Shape (n,). Index of each of ``robot.joint_names`` in Pinocchio's configuration, which has `size` places.
        followers: Of each joint that follows: its index there, its leader's, factor and offset [rad] or [m].
        link_joints: The joint that moves each link; 0: nothing does.
        strokes: Shape (size,). Largest absolute value of each joint [rad] or [m].
    """

    def __init__(self, robot: RobotModel):
        self.robot = robot
        self._meshes: dict[tuple[str, tuple[float, ...]], ObjectShapes] = {}
        try:
            urdf = with_mesh_files(_of_single_joints(robot))
            full = pinocchio.buildModelFromXML(urdf)
            shapes = pinocchio.buildGeomFromUrdfString(full, urdf, pinocchio.GeometryType.COLLISION)
        except (ElementTree.ParseError, ValueError, RuntimeError) as error:
            raise ConfigurationError("URDF", str(error), "a URDF with readable collision shapes") from error
        following = {other.name: other.following for other in robot.other_joints if other.following is not None}
        wanted = {*robot.joint_names, *following}
        locked = [index for index, name in enumerate(full.names) if index and name not in wanted]
        self.model, shapes = pinocchio.buildReducedModel(full, shapes, locked, _standing(robot, full))
        place = {name: self.model.joints[index].idx_q for index, name in enumerate(self.model.names) if index}
        self.order = np.array([place[name] for name in robot.joint_names])
        self.size = self.model.nq
        self.followers = tuple(
            (place[name], place[law.leader], law.factor, law.offset) for name, law in following.items()
        )
        self.strokes = np.zeros(self.size)
        self.strokes[self.order] = np.maximum(np.abs(robot.lower), np.abs(robot.upper))
        for at, leader, factor, offset in self.followers:
            self.strokes[at] = abs(factor) * self.strokes[leader] + abs(offset)
        frames = self.model.frames
        self.link_joints = {frame.name: frame.parentJoint for frame in frames if frame.type == pinocchio.FrameType.BODY}
        base = frames[self.model.getFrameId(robot.base_link)]
        self.root_T_base = base.placement
        self.bodies = tuple(
            Body(name := frames[shape.parentFrame].name, name, shape.parentJoint, shape.placement, _link_shape(shape, name))
            for shape in shapes.geometryObjects
        )  # fmt: skip

    def rows(self, qs: np.ndarray) -> np.ndarray:
        """Return Pinocchio's configurations, shape (m, size), of joint vectors, shape (m, n), mimic joints included."""
        rows = np.empty((len(qs), self.size))
        rows[:, self.order] = qs
        self.follow(rows)
        return rows

    def follow(self, rows: np.ndarray) -> None:
        """Put the joints that follow where they are, in values of Pinocchio's order, shape (m, size) or (size,)."""
        for at, leader, factor, offset in self.followers:
            rows[..., at] = factor * rows[..., leader] + offset

    @cached_property
    def joint_axes(self) -> tuple[tuple[int, np.ndarray, bool], ...]:
        """Of each joint, parents first: Pinocchio's index, its axis in its own frame, shape (3,), and whether it is prismatic."""
        data, neutral = self.model.createData(), pinocchio.neutral(self.model)
        axes = []
        for joint in range(1, self.model.njoints):
            column = pinocchio.computeJointJacobian(self.model, data, neutral, joint)[:, self.model.joints[joint].idx_v]
            linear = self.model.joints[joint].shortname().startswith("JointModelP")
            axes.append((joint, column[:3] if linear else column[3:], linear))
        return tuple(axes)

    def joint_places(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where all joints are in rows, shape (m, size): rotations, shape (m, j, 3, 3), and positions, shape (m, j, 3)."""
        rotations = np.empty((len(rows), self.model.njoints, 3, 3))
        positions = np.zeros((len(rows), self.model.njoints, 3))
        rotations[:, 0] = np.eye(3)
        sines, versines = np.sin(rows)[..., None, None], 1.0 - np.cos(rows)[..., None, None]
        for joint, axis, linear in self.joint_axes:
            parent, placement = self.model.parents[joint], self.model.jointPlacements[joint]
            place = self.model.joints[joint].idx_q
            # the rows of all matrices under each other: one product each
            flat = rotations[:, parent].reshape(-1, 3)
            positions[:, joint] = positions[:, parent] + (flat @ placement.translation).reshape(-1, 3)
            flat = flat @ placement.rotation
            rotations[:, joint] = flat.reshape(-1, 3, 3)
            if linear:
                positions[:, joint] += rows[:, [place]] * (flat @ axis).reshape(-1, 3)
            else:
                cross = pinocchio.skew(axis)
                crossed = flat @ cross
                rotations[:, joint] += sines[:, place] * crossed.reshape(-1, 3, 3)
                rotations[:, joint] += versines[:, place] * (crossed @ cross).reshape(-1, 3, 3)
        return rotations, positions

    def link_pose(self, q: JointValues, link: str) -> Pose:
        """Return a link's pose in the base_link; SceneError: the robot has no such link."""
        if link not in self.link_joints:
            raise SceneError("a link's name", link, f"a link of the robot: {sorted(self.link_joints)}")
        data = self.model.createData()
        pinocchio.framesForwardKinematics(self.model, data, self.rows(np.array([q], dtype=float))[0])
        frame = data.oMf[self.model.getFrameId(link, pinocchio.FrameType.BODY)]
        base_T_link = self.root_T_base.inverse() * frame
        return Pose(base_T_link.translation.copy(), base_T_link.rotation.copy())

    def place(self, item: SceneObject, objects: Collection[str] = ()) -> tuple[Body, ...]:
        """Return the bodies of a scene object, see `scene_shapes`; `objects` of its scene it may name in `touch`."""
        links = f"a link of the robot: {sorted(self.link_joints)}"
        if item.link and item.link not in self.link_joints:
            raise SceneError(f"object {item.name!r} link", item.link, links)
        for name in item.touch:
            if name not in self.link_joints and (name not in objects or name == item.name):
                others = f"another object of the scene: {names_text(set(objects) - {item.name})}"
                raise SceneError(f"object {item.name!r} touch", name, f"{links}, or {others}")
        if item.name in self.link_joints:
            raise SceneError("an object's name", item.name, "a name that no link of the robot has")
        pose = pinocchio.SE3(item.pose.rotation, item.pose.position)
        link, joint, placement = "", 0, self.root_T_base * pose
        if item.link:
            frame = self.model.frames[self.model.getFrameId(item.link, pinocchio.FrameType.BODY)]
            link, joint, placement = item.link, frame.parentJoint, frame.placement * pose
        shapes = self._shapes(item)
        return tuple(Body(item.name, link, joint, placement, shape, item, shapes) for shape in shapes.shapes)

    def place_all(self, scene: Scene) -> tuple[Body, ...]:
        """Return the bodies of all objects of a scene, in its order; see `place`."""
        return tuple(body for item in scene.objects for body in self.place(item, scene.names))

    def _shapes(self, item: SceneObject) -> ObjectShapes:
        """Return an object's shapes; a mesh is read and divided once, and again only when its contents are others."""
        if not item.mesh:
            return scene_shapes(item)
        key = (item.mesh_digest, item.size)
        if key not in self._meshes:
            if len(self._meshes) >= _MESHES_KEPT:
                self._meshes.clear()
            self._meshes[key] = scene_shapes(item)
        return self._meshes[key]


def _standing(robot: RobotModel, full: pinocchio.Model) -> np.ndarray:
    """Return a configuration of the whole URDF: joints outside of the chain where they stand, the others at zero."""
    positions = np.zeros(full.nv)
    for other in robot.other_joints:
        if other.position:
            positions[full.joints[full.getJointId(other.name)].idx_v] = other.position
    return pinocchio.integrate(full, pinocchio.neutral(full), positions)


def _of_single_joints(robot: RobotModel) -> str:
    """Return the URDF in which every joint that moves has one value for Pinocchio: no mimic joint, and revolute for continuous."""
    moving = {*robot.joint_names, *(other.name for other in robot.other_joints if other.following is not None)}
    root = ElementTree.fromstring(robot.urdf.encode())
    changed = False
    for joint in root.iterfind("joint"):
        mimic, continuous = joint.find("mimic"), joint.get("type") == "continuous"
        if joint.get("name") not in moving or (mimic is None and not continuous):
            continue
        changed = True
        if mimic is not None:
            joint.remove(mimic)
        if continuous:
            joint.set("type", "revolute")
        limit = joint.find("limit")
        if limit is None:
            limit = ElementTree.SubElement(joint, "limit", effort="0", velocity="0")
        # Pinocchio must have one; it is unused
        limit.attrib.update(lower=str(-_NO_LIMIT), upper=str(_NO_LIMIT))
    return ElementTree.tostring(root, encoding="unicode") if changed else robot.urdf


def scene_geometry(item: SceneObject) -> coal.CollisionGeometry:
    """Return the shape of a scene object, centred in the object's frame: one, of a mesh that is not convex its surface.

    What contacts are checked with are `scene_shapes`.
    """
    if item.shape == "box":
        return coal.Box(*item.size)
    if item.shape == "cylinder":
        return coal.Cylinder(*item.size)
    if item.shape == "sphere":
        return coal.Sphere(*item.size)
    return _mesh(item)


def scene_shapes(item: SceneObject) -> ObjectShapes:
    """Return the shapes of a scene object with which contacts are checked, in planner and simulation.

    A closed mesh is solid; one that is not convex becomes convex pieces that reach at most 5 mm beyond it. What cannot be divided
    so stays a surface: an arm completely inside it is not in contact with it.
    """
    whole = scene_geometry(item)
    if not isinstance(whole, coal.BVHModelBase):
        return ObjectShapes((whole,))
    # loaded here: most scenes have no such mesh, and manifold3d and scipy.spatial are tens of MB
    from construction_twin.scene.convex_pieces import convex_pieces  # noqa: PLC0415

    vertices, triangles = mesh_triangles(whole)
    pieces = convex_pieces(vertices, triangles)
    if pieces is None or pieces.reach > min(_FARTHEST, _FARTHEST_SHARE * float(np.ptp(vertices, axis=0).max())):
        return ObjectShapes((whole,))
    shapes = []
    for corners in pieces.corners:
        piece = _solid(surface(corners, np.empty((0, 3))))
        if piece is None:
            # a part less would be a hole
            return ObjectShapes((whole,))
        shapes.append(piece)
    return ObjectShapes(tuple(shapes), pieces.reach, None if pieces.whole is None else surface(*pieces.whole))


def _mesh(item: SceneObject) -> coal.CollisionGeometry:
    where = f"object {item.name!r} mesh"
    contents = read_mesh_file(item.name, item.mesh)
    if hashlib.sha256(contents).hexdigest() != item.mesh_digest:
        expected = "the file that the object was made with; it has changed, add the object again"
        raise SceneError(where, item.mesh, expected)
    x, y, z = item.size
    vertices, triangles = parse_mesh(where, item.mesh, contents, (x, y, z))
    mesh = surface(vertices, triangles)
    if not is_convex(*mesh_triangles(mesh)):
        return mesh
    if (body := _solid(mesh)) is None:
        raise SceneError(where, item.mesh, "a closed convex mesh that has a volume")
    return body


def _link_shape(shape: pinocchio.GeometryObject, link: str) -> coal.CollisionGeometry:
    """Return a closed convex mesh as a solid body, whose distances cost a hundredth of a surface's; any other shape as it is."""
    geometry, path, where = shape.geometry, shape.meshPath, f"URDF link {link} collision mesh"
    if not isinstance(geometry, coal.BVHModelBase):
        return geometry
    if path.lower().endswith(".glb"):
        # Coal drops what the root node does to those below it
        x, y, z = shape.meshScale
        geometry = surface(*parse_mesh(where, path, Path(path).read_bytes(), (x, y, z)))
    vertices, triangles = mesh_triangles(geometry)
    size = float(np.ptp(vertices, axis=0).max())
    if not _SMALLEST <= size <= _LARGEST:
        expected = f'{_SMALLEST:g} to {_LARGEST:g} m: a file in mm needs scale="0.001 0.001 0.001" in its <mesh>, one in m none'
        raise ConfigurationError(where, f"{path}, {size:.4g} m large", expected)
    # a plate that is closed, but has no volume, can be checked as a surface only
    body = _solid(geometry) if is_convex(vertices, triangles) else None
    return geometry if body is None else body


def _solid(mesh: coal.BVHModelBase) -> coal.CollisionGeometry | None:
    """Return the hull of a mesh; None: it has no volume, or is too thin for Coal."""
    try:
        mesh.buildConvexHull(True, "Qt")
    except RuntimeError:
        return None
    return mesh.convex


def mesh_triangles(mesh: coal.BVHModelBase) -> tuple[np.ndarray, np.ndarray]:
    """Return a mesh's vertices, shape (v, 3) [m], and triangles, shape (t, 3): equal vertices are one."""
    vertices, merged = np.unique(np.round(mesh.vertices(), 9), axis=0, return_inverse=True)
    triangles = np.array(
        [[triangle[0], triangle[1], triangle[2]] for triangle in map(mesh.tri_indices, range(mesh.num_tris))]
    )
    return vertices, merged.reshape(-1)[triangles]


def is_convex(vertices: np.ndarray, triangles: np.ndarray) -> bool:
    """Return whether triangles, shape (t, 3), of vertices, shape (v, 3) [m], make a closed convex body."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    if not (uses == 2).all():
        return False
    size = np.ptp(vertices, axis=0).max()
    first, second, third = (vertices[triangles[:, corner]] for corner in range(3))
    normals = np.cross(second - first, third - first)
    lengths = np.linalg.norm(normals, axis=1)
    real = lengths > _CONVEX_TOLERANCE * size**2
    normals, first = normals[real] / lengths[real, None], first[real]
    # one side of every face must be empty; which one depends on the order of the triangles' corners in the file
    offsets = np.einsum("ij,ij->i", normals, first)
    for start in range(0, len(normals), 256):
        sides = normals[start : start + 256] @ vertices.T - offsets[start : start + 256, None]
        if (np.minimum(sides.max(axis=1), -sides.min(axis=1)) > _CONVEX_TOLERANCE * size).any():
            return False
    return True


def shape_contents(geometry: coal.CollisionGeometry) -> list:
    """Return a shape's kind and numbers, rounded to 1e-9, for a hash."""
    if isinstance(geometry, coal.Box):
        numbers = geometry.halfSide
    elif isinstance(geometry, (coal.Cylinder, coal.Capsule)):
        numbers = (geometry.radius, geometry.halfLength)
    elif isinstance(geometry, coal.Sphere):
        numbers = (geometry.radius,)
    elif isinstance(geometry, coal.BVHModelBase):
        numbers = geometry.vertices().ravel()
    elif isinstance(geometry, coal.ConvexBase):
        numbers = geometry.points().ravel()
    else:
        raise ConfigurationError("URDF collision shape", type(geometry).__name__, "a box, cylinder, sphere or mesh")
    return [type(geometry).__name__, *(np.round(np.asarray(numbers, dtype=float), 9) + 0.0).tolist()]


def measured(
    first: coal.CollisionGeometry, at: coal.Transform3s, second: coal.CollisionGeometry, to: coal.Transform3s
) -> coal.DistanceResult:
    """Return the distance of two shapes, with the points where they are closest.

    Where Coal knows no depth, the first shape is moved by up to 0.1 mm, which is subtracted.
    """
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.gjk_tolerance = _GJK_TOLERANCE
    coal.distance(first, at, second, to, request, result)
    if result.min_distance > UNKNOWN:
        return result
    rotation, position = at.getRotation(), at.getTranslation()
    for size, direction in itertools.product(_ASIDE, np.vstack([np.eye(3), -np.eye(3)])):
        result = coal.DistanceResult()
        aside = coal.Transform3s(rotation, position + size * direction)
        coal.distance(first, aside, second, to, request, result)
        if result.min_distance > UNKNOWN:
            result.min_distance -= size
            return result
    raise SceneError("two shapes that touch", "no depth that Coal can measure", "a pose 0.1 mm from there")


def configure_coal(data: pinocchio.GeometryData, margins: Sequence[float] = ()) -> None:
    """Configure Coal's contact and distance requests: repeatable answers, every contact found, `margins` of the pairs [m].

    The warm start of the distance search is switched off, because it makes an answer depend on earlier ones. Contact points are
    asked for, although nobody reads them: without them Coal's GJK calls a few of ten thousand deep contacts of convex bodies free
    (Coal 3.0.3: 3 of 20,000 poses of two hulls of 125 and 156 vertices, 88 mm inside each other; with them none).
    """
    pairs = len(data.collisionRequests)
    if not pairs:
        return
    # a request is written once and copied as a whole: writing to each of thousands takes longer than making the data
    contact, distance = data.collisionRequests[0], data.distanceRequests[0]
    with warnings.catch_warnings():
        # the switch is deprecated, but its replacement has no effect while it is on, and it is on by default
        warnings.simplefilter("ignore", DeprecationWarning)
        contact.enable_cached_gjk_guess = distance.enable_cached_gjk_guess = False
    distance.gjk_tolerance = _GJK_TOLERANCE
    contact.enable_contact = True
    of_margin = type(data.collisionRequests)()
    places: dict[float, int] = {}
    each = [margins[pair] if margins else 0.0 for pair in range(pairs)]
    for margin in dict.fromkeys(each):
        contact.security_margin = margin
        places[margin] = len(of_margin)
        of_margin.append(contact)
    contacts, distances = type(data.collisionRequests)(), type(data.distanceRequests)()
    contacts.extend([of_margin[places[margin]] for margin in each])
    distances.extend([distance] * pairs)
    data.collisionRequests, data.distanceRequests = contacts, distances
