"""A plan, carried out by the simulated arm faster than real time, before a person approves it. SI; joints as in `PhysicsModel`.

It finds torques against the drives', the payload against the arm's rating, contacts that the plan does not have, how far the arm
goes on when it must stop at the worst moment, and what becomes of what is let go: that lies on in the scene of the next segment.

The planner's scene has every element where it was planned to be: without the mortar between two bricks, or a hair inside its
neighbour. So the simulation first lets everything come to rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import partial

import mujoco
import numpy as np
import pinocchio

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import CYCLE
from construction_twin.extensions.physics.arm import GravityTorque, Servo, SimulatedArm, is_broken
from construction_twin.extensions.physics.drive import ArmDrives
from construction_twin.extensions.physics.grip import GripLoadRecorder, SuctionGrip
from construction_twin.extensions.physics.judgement import (
    SETTLING,
    STAYS,
    STAYS_TURNED,
    Track,
    braking,
    failure_reasons,
    worst_payload,
)
from construction_twin.extensions.physics.known_mass import TOOL, body_of
from construction_twin.extensions.physics.mass import MassProperties
from construction_twin.extensions.physics.model import Load, PhysicsModel, build_model
from construction_twin.kinematics.chain import Chain
from construction_twin.review.rehearsal_report import (
    FAILED,
    PASSED,
    GripLoad,
    LooseObject,
    RehearsalReport,
    RehearsedContact,
    has_finite_numbers,
    with_hash,
)
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene, SceneObject, names_text
from construction_twin.scene.self_collision import SelfCollision

#: A contact that the plan does not have counts from this force on [N]: two bodies that graze each other within rounding do not.
LEAST_FORCE = 1.0
#: Pieces whose numbers in one another's frames differ by less than this lie as before: rounding [1], [m].
_SAME = 1e-4
#: For so long the arm, whose servo lags, is watched after the end of a plan that leaves nothing loose [s].
_COMING_TO_REST = 0.2
#: What sinks by more than this stands on nothing that the scene has, such as mortar [m]: in the simulation the wall would be lower
#: than the plan has it.
SINKS = 0.001
#: A body slower than this lies still [m/s], [rad/s].
STILL = 0.01
#: So many bodies can be tipped over, those nearest to the tool's path: what lies awake takes time.
MOST = 40
#: For so long bodies that are inside each other part, without getting any speed from it [s].
_PARTING = 0.1
#: What stands without the restless may be restless itself: it is looked at anew so often. What is left then is fixed, too.
_ROUNDS = 4
#: Poses along a plan from which distances are measured.
_POSES = 64
#: What simulates.
ENGINE = f"MuJoCo {mujoco.__version__}"


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """Rehearses the plans of one arm.

    Attributes:
        masses: Of objects, by name [kg]. What stands and has one can be tipped over.
        unweighed: Standing elements of unknown mass: part of the world.
        flange: A payload without a shape, in the frame of the tip link.
        grip: The tool's cups; None: it has none.
        tool, inputs: Hashes of the tool file, and of what else decides the result.
    """

    bodies: RobotBodies
    self_collision: SelfCollision
    drives: ArmDrives
    servo: Servo = Servo()
    masses: Mapping[str, float] = field(default_factory=dict)
    unweighed: Sequence[str] = ()
    flange: MassProperties | None = None
    grip: SuctionGrip | None = None
    tool: str = ""
    inputs: str = ""

    def of_plan(self, plan: Plan, scenes: Mapping[str, Scene], clock: Callable[[], float]) -> RehearsalReport:
        """Rehearse a plan; `clock`: for how long it took, e.g. ``time.perf_counter`` [s]."""
        begin = clock()
        named = RehearsalReport(
            plan_id=plan.id, plan_hash=plan.hash, scene=plan.scene, tool=self.tool, inputs=self.inputs, engine=ENGINE
        )
        wanted = [segment.scene for segment in plan.segments] or [plan.scene]
        last = plan.segments[-1].scene_after if plan.segments else plan.scene
        missing = [each for each in (*wanted, last) if each not in scenes]
        if missing:
            reason = Sentence("the scene {scene} that a segment needs is not known here", scene=missing[0][:12])
            return with_hash(replace(named, reasons=(reason,)), clock() - begin)
        ends = [segment.end for segment in plan.segments] or [plan.trajectory.duration]
        parts = [(scenes[scene], end) for scene, end in zip(wanted, ends)]
        run = _Run(self, plan.trajectory, parts, scenes[last])
        try:
            found = run.report(named, clock)
        # ValueError: MuJoCo's compiler refuses a model
        except (ConstructionTwinError, mujoco.FatalError, ValueError) as error:
            reason = Sentence("the simulation broke off: {problem}", problem=" ".join(str(error).split()))
            found = replace(named, reasons=(reason,))
        return with_hash(found, clock() - begin)


def rigid_bodies(scenes: Iterable[Scene]) -> dict[str, str]:
    """Return the body that each object is a piece of while a plan goes through `scenes`, by the object's name.

    Pieces form one body while their relative poses stay the same in all scenes; else each is a body of its own name.
    """
    found: dict[str, str] = {}
    first: dict[str, Sequence[SceneObject]] = {}
    apart: set[str] = set()
    for scene in scenes:
        pieces: dict[str, list[SceneObject]] = {}
        for item in sorted(scene.objects, key=lambda each: each.name):
            body = found[item.name] = body_of(item.name)
            pieces.setdefault(body, []).append(item)
        for body, items in pieces.items():
            if not _is_rigid(first.setdefault(body, items), items):
                apart.add(body)
    return {name: name if body in apart else body for name, body in found.items()}


def _is_rigid(before: Sequence[SceneObject], now: Sequence[SceneObject]) -> bool:
    """Return whether pieces, sorted by name, can be one body that was carried from one place to another."""
    if [item.name for item in before] != [item.name for item in now] or len({item.link for item in now}) > 1:
        return False
    places, others = ([_placement(item) for item in items] for items in (before, now))
    return all(
        np.abs(places[0].actInv(place).homogeneous - others[0].actInv(other).homogeneous).max() < _SAME
        for place, other in zip(places[1:], others[1:])
    )


def _placement(item: SceneObject) -> pinocchio.SE3:
    return pinocchio.XYZQUATToSE3(np.array((*item.position, *item.quaternion)))


@dataclass(frozen=True, eq=False)
class RestingBodies:
    """How bodies stand before a plan begins.

    Attributes:
        places: By body: where it lies at rest, shape (7,): x, y, z [m], and the quaternion w, x, y, z.
        restless: Bodies that move without the plan, and how far [m].
    """

    places: Mapping[str, np.ndarray] = field(default_factory=dict)
    restless: Mapping[str, float] = field(default_factory=dict)


def displacement(before: np.ndarray, now: np.ndarray) -> tuple[float, float, float]:
    """Return how far a body has moved [m], turned [rad] and sunk [m] between two places, each of shape (7,)."""
    turned = 2.0 * math.acos(min(1.0, abs(float(before[3:] @ now[3:]))))
    return float(np.linalg.norm(now[:3] - before[:3])), turned, float(before[2] - now[2])


def come_to_rest(
    build: Callable[[Mapping[str, str]], PhysicsModel], pieces: Mapping[str, str], pose: np.ndarray, servo: Servo
) -> RestingBodies | None:
    """Let bodies come to rest around an arm that stands still; None: the simulation diverged.

    Args:
        build: Returns the model in which some objects are loose, see `Load.loose`.
        pieces: Body of each object that can be moved, by name.
    """
    restless: dict[str, float] = {}
    for number in range(_ROUNDS + 1):
        left = {name: body for name, body in pieces.items() if body not in restless}
        if not left:
            break
        arm = SimulatedArm(build(left), pose, servo)
        before = {body: arm.loose_state(body)[0] for body in arm.physics.loose}
        _settle(arm, pose)
        if not np.isfinite(arm.data.qpos).all():
            return None
        after = {body: arm.loose_state(body) for body in before}
        moved = {body: displacement(before[body], place) for body, (place, _) in after.items()}
        found = {
            body: way
            for body, (way, turned, sunk) in moved.items()
            if sunk > SINKS or way > STAYS or turned > STAYS_TURNED or np.abs(after[body][1]).max() > STILL
        }
        if not found:
            return RestingBodies({body: place for body, (place, _) in after.items()}, restless)
        restless |= found if number < _ROUNDS else {body: way for body, (way, _, _) in moved.items()}
    return RestingBodies({}, restless)


def _settle(arm: SimulatedArm, pose: np.ndarray) -> None:
    """Separate overlapping loose bodies, and simulate until all sleep, for `SETTLING` at most."""
    data = arm.data
    speeds = np.concatenate([arm.speeds_of(body) for body in arm.physics.loose])
    for _ in range(round(_PARTING / CYCLE)):
        for _step in arm.steps(pose):
            # two bricks that are planned a millimetre into each other part; they do not jump
            data.qvel[speeds] = 0.0
    arm.physics.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
    for _ in range(round(SETTLING / CYCLE)):
        arm.cycle(pose)
        # what sleeps has no speed at all
        if not data.qvel[speeds].any():
            return


def nearest_bodies(
    objects: Iterable[SceneObject], bodies: Mapping[str, str], robot: RobotModel, poses: np.ndarray
) -> list[str]:
    """Return the bodies of objects, those first that the tool comes nearest to along `poses`, shape (m, n); then by name."""
    rows = poses[np.unique(np.linspace(0, len(poses) - 1, _POSES).round().astype(int))]
    chain = Chain(robot)
    path = np.array([chain.forward(row).position for row in rows])
    found: dict[str, float] = {}
    for item in objects:
        away = float(np.linalg.norm(path - np.array(item.position), axis=1).min())
        body = bodies[item.name]
        found[body] = min(away, found.get(body, math.inf))
    return sorted(found, key=lambda body: (found[body], body))


class _Run:
    """One rehearsal.

    Args:
        parts: Scene and end of each part of the plan [s].
        after: The scene at the end, when the last tool has switched.
    """

    def __init__(self, of: Rehearsal, trajectory: Trajectory, parts: Sequence[tuple[Scene, float]], after: Scene):
        self._rehearsal = of
        self._trajectory = trajectory
        self._parts = parts
        self._after = after
        scenes = (*(scene for scene, _ in parts), after)
        self._bodies = rigid_bodies(scenes)
        carried = [{item.name for item in scene.objects if item.link} for scene in scenes]
        self._carried = frozenset[str]().union(*carried)
        # what is picked up or let go: the tool is in every scene on the arm, and is neither
        self._handled = self._carried - carried[0].intersection(*carried)
        self._track = Track(of.drives)
        self._contacts: dict[tuple[str, str], RehearsedContact] = {}
        self._payloads: list[MassProperties] = []
        self._released: dict[str, float] = {}
        self._before: dict[str, np.ndarray] = {}
        self._displaced: dict[str, LooseObject] = {}
        self._grips = [GripLoad()]
        self._remarks: list[str] = []
        self._standing = RestingBodies()
        #: What has a mass and is part of the world all the same.
        self._fixed: frozenset[str] = frozenset()

    def report(self, named: RehearsalReport, clock: Callable[[], float]) -> RehearsalReport:
        """Play the whole plan, let everything come to rest, and return `named` with what was found."""
        times = np.arange(math.ceil(self._trajectory.duration / CYCLE - 1e-9) + 1) * CYCLE
        setpoints = self._trajectory.sample_many(times)[0]
        arm: SimulatedArm | None = None
        first, begin = 0, 0.0
        started = clock()
        if not self._settle_standing(setpoints):
            return self._diverged(named, 0.0)
        settle = clock() - started
        for number, (scene, end) in enumerate(self._parts):
            last = len(times) if number == len(self._parts) - 1 else round(end / CYCLE)
            arm = self._arm(scene, setpoints[first], arm, begin)
            # what lies still, far from the arm, costs nothing
            arm.physics.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
            diverged = self._play(arm, times[first:last], setpoints[first:last], self._recorder(scene, arm.physics))
            if diverged is not None:
                return self._diverged(named, diverged)
            first, begin = last, end
        assert arm is not None
        started = clock()
        arm = self._arm(self._after, setpoints[-1], arm, begin)
        objects = self._settled(arm, setpoints[-1])
        settle += clock() - started
        if is_broken(arm.data):
            return self._diverged(named, self._trajectory.duration)
        return self._judged_report(named, times, objects, settle)

    def _diverged(self, named: RehearsalReport, time: float) -> RehearsalReport:
        reason = Sentence(
            "the simulation came apart after {time:.2f} s of the plan: its numbers are no motion", time=time
        )
        return replace(named, state=FAILED, reasons=(reason,), remarks=tuple(dict.fromkeys(self._remarks)))

    def _settle_standing(self, setpoints: np.ndarray) -> bool:
        """Let the standing bodies come to rest before the plan; return False when the simulation diverged."""
        of, scene = self._rehearsal, self._parts[0][0]
        names = {item.name for item in scene.objects if not item.link} & of.masses.keys() - self._handled
        known = {self._bodies[name] for name in names} - {self._bodies[name] for name in self._handled}
        objects = [item for item in scene.objects if self._bodies[item.name] in known]
        near = nearest_bodies(objects, self._bodies, of.bodies.robot, setpoints) if len(known) > MOST else sorted(known)
        pieces = {item.name: self._bodies[item.name] for item in objects if self._bodies[item.name] in near[:MOST]}
        standing = come_to_rest(partial(self._model, scene), pieces, setpoints[0], of.servo)
        if standing is None:
            return False
        self._standing, self._fixed = standing, frozenset({*standing.restless, *near[MOST:]})
        if standing.restless:
            most = f"{max(standing.restless.values()) * 1e3:.1f} mm: {names_text(standing.restless)}"
            self._remarks.append(
                f"fixed in this rehearsal, nothing tips them over; they would move without any plan, by up to {most}"
            )
        if near[MOST:]:
            more = f"{len(near) - MOST} elements further from the path than the nearest {MOST}"
            self._remarks.append(f"fixed in this rehearsal, nothing tips them over: {more}")
        if of.unweighed:
            self._remarks.append(
                f"fixed in this rehearsal, nothing tips them over, their masses are unknown: {names_text(of.unweighed)}"
            )
        return True

    def _arm(self, scene: Scene, pose: np.ndarray, before: SimulatedArm | None, begin: float) -> SimulatedArm:
        """Return the arm in a scene, from `begin` [s] on; released bodies continue from where they are."""
        loose = {self._bodies[one] for one in {*scene.names} & {*self._handled, *self._rehearsal.masses}} - self._fixed
        physics = self._model(scene, {name: body for name, body in self._bodies.items() if body in loose})
        self._remarks += physics.remarks
        if physics.payload is not None:
            self._payloads.append(physics.payload)
        arm = SimulatedArm(physics, pose if before is None else before.setpoint, self._rehearsal.servo)
        if before is None:
            for name, place in self._standing.places.items():
                arm.put_loose(name, place)
        else:
            arm.continue_from(before)
            for name in before.physics.loose:
                if name in physics.loose:
                    arm.put_loose(name, *before.loose_state(name))
                elif (displaced := self._loose_object(before, name)).moved > STAYS:
                    # the arm picks up where the plan has it, but it is not there any more
                    self._displaced[name] = displaced
            for name in sorted(physics.loose.keys() - before.physics.loose.keys()):
                self._released[name] = begin
                self._before.pop(name, None)
        mujoco.mj_forward(physics.model, arm.data)
        for name in physics.loose:
            self._before.setdefault(name, arm.loose_state(name)[0])
        return arm

    def _model(self, scene: Scene, loose: Mapping[str, str]) -> PhysicsModel:
        of = self._rehearsal
        return build_model(of.bodies, scene, of.self_collision, of.drives, Load(of.masses, loose, of.flange))

    def _scene_at(self, time: float) -> Scene:
        return next((scene for scene, end in self._parts if time < end), self._parts[-1][0])

    def _recorder(self, scene: Scene, physics: PhysicsModel) -> GripLoadRecorder | None:
        """Return the recorder of the cups' load in a scene; None without load or cups."""
        of = self._rehearsal
        tip = of.bodies.robot.tip_link
        carried = [item for item in scene.objects if item.link == tip and body_of(item.name) != TOOL]
        if of.grip is None or not carried:
            return None
        bodies = of.bodies
        frame = bodies.model.frames[bodies.model.getFrameId(tip)]
        to_tip = frame.placement.inverse()
        pieces = [piece for item in carried for piece in bodies.place(item, scene.names)]
        grip = of.grip.on([replace(piece, placement=to_tip * piece.placement) for piece in pieces])
        name = self._bodies[carried[0].name]
        if not len(grip.cups):
            self._remarks.append(f"no cup of the tool lies on {name}: whether it is held is not looked at")
            return None
        return GripLoadRecorder(
            grip, name, physics, [item.name for item in carried], bodies.model.names[frame.parentJoint], frame.placement
        )

    def _play(
        self, arm: SimulatedArm, times: np.ndarray, setpoints: np.ndarray, watch: GripLoadRecorder | None
    ) -> float | None:
        """Play setpoints, record torques and contacts; return when the simulation diverged [s], None if it did not."""
        physics, data = arm.physics, arm.data
        gravity = GravityTorque(physics)
        for at, setpoint in zip(times.tolist(), setpoints):
            lowest = highest = np.zeros(len(setpoint))
            for _step in arm.steps(setpoint):
                # these keep a nan
                lowest, highest = np.minimum(lowest, arm.needed), np.maximum(highest, arm.needed)
                if data.ncon:
                    self._record_contacts(physics, data, at, frozenset())
            peak = np.where(highest > -lowest, highest, lowest)
            if is_broken(data) or not np.isfinite(peak).all():
                return at
            self._track.record_cycle(arm, peak, gravity)
            if watch is not None:
                watch.record_step(at, data)
        if watch is not None:
            self._grips.append(watch.worst())
        return None

    def _record_contacts(self, physics: PhysicsModel, data: mujoco.MjData, at: float, without: Set[str]) -> None:
        """Record the contacts of this step; the forces of two bodies at several points are added up."""
        geoms = data.contact.geom
        forces: dict[tuple[str, str], float] = {}
        largest: dict[tuple[str, str], tuple[float, int]] = {}
        force = np.zeros(6)
        for number in np.flatnonzero(physics.unplanned[geoms[:, 0], geoms[:, 1]]).tolist():
            first, second = sorted((physics.owners[geom] for geom in geoms[number].tolist()), key=self._named_first)
            names = first, second
            if without.isdisjoint(self._bodies.get(name, name) for name in names):
                mujoco.mj_contactForce(physics.model, data, number, force)
                size = float(np.linalg.norm(force[:3]))
                forces[names] = forces.get(names, 0.0) + size
                largest[names] = max(largest.get(names, (-1.0, 0)), (size, number))
        for names, size in forces.items():
            if not size < LEAST_FORCE:
                known = self._contacts.get(names)
                if known is None:
                    known = RehearsedContact(*names, at, self._in_base(data.contact.pos[largest[names][1]]), 0.0, 0.0)
                self._contacts[names] = replace(
                    known,
                    force=float(np.maximum(known.force, size)),
                    seconds=known.seconds + physics.model.opt.timestep,
                )

    def _in_base(self, point: np.ndarray) -> tuple[float, float, float]:
        x, y, z = self._rehearsal.bodies.root_T_base.actInv(point).tolist()
        return x, y, z

    def _named_first(self, owner: str) -> tuple[bool, bool, str]:
        """Return the order in which reports name two bodies: a link, what is carried sometime, what stands."""
        return owner not in self._rehearsal.bodies.link_joints, owner not in self._carried, owner

    def _settled(self, arm: SimulatedArm, setpoint: np.ndarray) -> tuple[LooseObject, ...]:
        """Let the arm and all loose bodies come to rest, none asleep, and return their displacements."""
        duration = self._trajectory.duration
        # nobody has planned how far the tool is from what it has let go of at the very end
        without = {name for name, released in self._released.items() if released >= duration}
        for _ in range(round((SETTLING if arm.physics.loose else _COMING_TO_REST) / CYCLE)):
            for _step in arm.steps(setpoint):
                if arm.data.ncon:
                    self._record_contacts(arm.physics, arm.data, duration, without)
        found = dict(self._displaced)
        for name in arm.physics.loose:
            one = self._loose_object(arm, name)
            if name in self._released or one.moved > STAYS or one.turned > STAYS_TURNED:
                found.setdefault(name, one)
        return tuple(found.values())

    def _loose_object(self, arm: SimulatedArm, name: str) -> LooseObject:
        """Return the motion of a loose object until now."""
        before = self._before[name]
        now, speed = arm.loose_state(name)
        released = self._released.get(name, math.nan)
        return LooseObject(name, released, *displacement(before, now), bool(np.abs(speed).max() < STILL))

    def _judged_report(self, named, times, objects, settle) -> RehearsalReport:
        track, names = self._track, self._trajectory.joint_names
        worst, off = int(np.argmax(track.usages)), int(np.argmax(track.off))
        brake = braking(track, self._rehearsal.bodies.robot, lambda time: self._model(self._scene_at(time), {}))
        report = replace(
            named,
            axes=track.axes(names, times),
            payload=worst_payload(self._payloads, self._rehearsal.bodies, self._rehearsal.drives.rating),
            tracking=float(track.off[off]),
            tracking_joint=names[off],
            braking=brake,
            worst_time=float(times[worst]),
            worst_pose=tuple(track.poses[worst].tolist()),
            contacts=tuple(self._contacts.values()),
            objects=objects,
            grip=self._grips[int(np.argmax([load.usage for load in self._grips]))],
            energy=track.energy(),
            duration=self._trajectory.duration,
            settle_took=settle,
            remarks=tuple(dict.fromkeys(self._remarks)),
        )
        if not has_finite_numbers(report):
            # of what is not finite nothing is too large
            return self._diverged(named, self._trajectory.duration if math.isfinite(brake.usage) else brake.time)
        robot = self._rehearsal.bodies.robot
        linear = {name for name, slides in zip(robot.joint_names, robot.linear) if slides}
        why = tuple(failure_reasons(report, linear))
        return replace(report, state=FAILED if why else PASSED, reasons=why)
