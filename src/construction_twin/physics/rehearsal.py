"""A plan, carried out by the simulated arm faster than real time, before a person approves it. SI; joints as in `PhysicsModel`.

What it finds: torques against what the drives can give, the payload against the arm's rating, contacts that the plan does not have,
how far the arm goes on when it must stop at the worst moment, and what becomes of what is let go. A plan of several segments has a
scene for each; what was let go in one goes on lying where it lies in the next.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from construction_twin.core.axis_name import axis_name
from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.core.units import CYCLE
from construction_twin.physics.arm import Servo, SimulatedArm
from construction_twin.physics.constants import GRAVITY
from construction_twin.physics.drive import ArmDrives
from construction_twin.physics.grip import GripWatch, SuctionGrip
from construction_twin.physics.known_mass import TOOL, body_of
from construction_twin.physics.mass import MassProperties
from construction_twin.physics.model import Load, PhysicsModel, build_model
from construction_twin.physics.report import (
    FAILED,
    PASSED,
    AxisLoad,
    Braking,
    GripLoad,
    LooseObject,
    PayloadLoad,
    RehearsalReport,
    RehearsedContact,
    finished,
    has_finite_numbers,
)
from construction_twin.physics.rigid_bodies import rigid_bodies
from construction_twin.robot.plan import Plan
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision

#: A contact that the plan does not have counts from this force on [N]: two bodies that graze each other within rounding do not.
LEAST_FORCE = 1.0
#: An object that was let go stays where it is when it moves and turns by no more than this [m], [rad].
STAYS, STAYS_TURNED = 0.005, math.radians(1.0)
#: For so long what was let go is watched [s].
SETTLING = 2.0
#: A body slower than this lies still [m/s], [rad/s].
STILL = 0.01
#: The arm is off its setpoint by more than this, beyond its lag, when something holds it [rad], [m].
LARGEST_TRACKING = math.radians(0.5)
#: For so long the arm, whose servo lags, is watched after the end of a plan that leaves nothing loose [s].
_COMING_TO_REST = 0.2
#: Longest time that braking may take [s].
_LONGEST_BRAKING = 10.0


@dataclass(frozen=True)
class Limits:
    """From where on a rehearsal has failed.

    Attributes:
        torque: Fraction of an axis' torque.
        stays, stays_turned: How far what is let go may move [m] and turn [rad].
        settling: For how long that is watched [s].
    """

    torque: float = 1.0
    stays: float = STAYS
    stays_turned: float = STAYS_TURNED
    settling: float = SETTLING


@dataclass(frozen=True, eq=False)
class Part:
    """One part of a plan in one scene: until `end` [s] of the plan's trajectory."""

    scene: Scene
    end: float


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """What rehearses the plans of one arm.

    Attributes:
        masses: Of objects, by name [kg].
        flange: A payload without a shape, in the frame of the tip link.
        grip: The tool's cups; None: it has none, and whether it holds what it carries is not looked at.
        tool, inputs: Hashes of the tool file, and of what else decides the result, as the report has them.
        gravity: Length 3. In the root of the URDF [m/s^2].
    """

    bodies: RobotBodies
    self_collision: SelfCollision
    drives: ArmDrives
    servo: Servo = Servo()
    limits: Limits = Limits()
    masses: Mapping[str, float] = field(default_factory=dict)
    flange: MassProperties | None = None
    grip: SuctionGrip | None = None
    tool: str = ""
    inputs: str = ""
    gravity: tuple[float, float, float] = (0.0, 0.0, -GRAVITY)

    def of_plan(
        self,
        plan: Plan,
        scenes: Mapping[str, Scene],
        clock: Callable[[], float],
        progress: Callable[[float, SimulatedArm], None] | None = None,
    ) -> RehearsalReport:
        """Rehearse a plan.

        Args:
            scenes: By hash: that of the plan, and those of its segments.
            clock: For how long it took, e.g. ``time.perf_counter`` [s].
            progress: Called after each cycle with the time in the plan [s] and the arm as it is then.
        """
        begin = clock()
        named = RehearsalReport(
            plan_id=plan.id, plan_hash=plan.hash, scene=plan.scene, tool=self.tool, inputs=self.inputs, engine=ENGINE
        )
        wanted = [segment.scene for segment in plan.segments] or [plan.scene]
        last = plan.segments[-1].scene_after if plan.segments else plan.scene
        missing = [each for each in (*wanted, last) if each not in scenes]
        if missing:
            return finished(
                replace(named, reasons=(Sentence("rehearsal.no_scene", scene=missing[0][:12]),)), clock() - begin
            )
        ends = [segment.end for segment in plan.segments] or [plan.trajectory.duration]
        parts = [Part(scenes[scene], end) for scene, end in zip(wanted, ends)]
        run = _Run(self, plan.trajectory, parts, scenes[last], progress)
        try:
            found = run.report(named, clock)
        # ValueError: MuJoCo's compiler refuses a model
        except (ConstructionTwinError, mujoco.FatalError, ValueError) as error:
            found = replace(named, reasons=(Sentence("rehearsal.engine", problem=" ".join(str(error).split())),))
        return finished(found, clock() - begin)


#: What simulates.
ENGINE = f"MuJoCo {mujoco.__version__}"


class _Run:
    """One rehearsal: it steps the arm through the parts, and notes.

    Args:
        after: The scene at the end, when the last tool has switched.
    """

    def __init__(self, of: Rehearsal, trajectory: Trajectory, parts: Sequence[Part], after: Scene, progress=None):
        self._of = of
        self._trajectory = trajectory
        self._parts = parts
        self._after = after
        self._progress = progress
        scenes = (*(part.scene for part in parts), after)
        self._bodies = rigid_bodies(scenes)
        carried = [{item.name for item in scene.objects if item.link} for scene in scenes]
        self._carried = frozenset[str]().union(*carried)
        # what is picked up or let go: the tool is in every scene on the arm, and is neither
        self._handled = self._carried - carried[0].intersection(*carried)
        self._torques: list[np.ndarray] = []
        self._speeds: list[np.ndarray] = []
        self._poses: list[np.ndarray] = []
        self._gravity: list[np.ndarray] = []
        self._usages: list[float] = []
        self._kinetic: list[float] = []
        self._off = np.zeros(len(trajectory.joint_names))
        self._contacts: dict[tuple[str, str], RehearsedContact] = {}
        self._payloads: list[MassProperties] = []
        self._released: dict[str, float] = {}
        self._before: dict[str, np.ndarray] = {}
        self._displaced: dict[str, LooseObject] = {}
        self._grips = [GripLoad()]
        self._remarks: list[str] = []

    def report(self, named: RehearsalReport, clock: Callable[[], float]) -> RehearsalReport:
        """Play the whole plan, let everything come to rest, and return `named` with what was found."""
        times = np.arange(math.ceil(self._trajectory.duration / CYCLE - 1e-9) + 1) * CYCLE
        setpoints = self._trajectory.sample_many(times)[0]
        arm: SimulatedArm | None = None
        first, begin = 0, 0.0
        for number, part in enumerate(self._parts):
            last = len(times) if number == len(self._parts) - 1 else round(part.end / CYCLE)
            arm = self._arm(part.scene, setpoints[first], arm, begin)
            # what lies still, far from the arm, costs nothing
            arm.physics.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
            diverged = self._play(arm, times[first:last], setpoints[first:last], self._watch(part.scene, arm.physics))
            if diverged is not None:
                return self._diverged(named, diverged)
            first, begin = last, part.end
        assert arm is not None
        started = clock()
        arm = self._arm(self._after, setpoints[-1], arm, begin)
        objects = self._settled(arm, setpoints[-1])
        settle = clock() - started
        if _is_broken(arm.data):
            return self._diverged(named, self._trajectory.duration)
        return self._judged(named, times, objects, settle)

    def _diverged(self, named: RehearsalReport, time: float) -> RehearsalReport:
        reason = Sentence("rehearsal.diverged", time=time)
        return replace(named, state=FAILED, reasons=(reason,), remarks=tuple(dict.fromkeys(self._remarks)))

    def _arm(self, scene: Scene, pose: np.ndarray, before: SimulatedArm | None, begin: float) -> SimulatedArm:
        """Return the arm in a scene, from `begin` [s] on; what was let go goes on from where it is."""
        loose = {self._bodies[name] for name in (self._handled | {*self._of.masses}) & set(scene.names)}
        physics = self._model(scene, {name: body for name, body in self._bodies.items() if body in loose})
        self._remarks += physics.remarks
        if physics.payload is not None:
            self._payloads.append(physics.payload)
        arm = SimulatedArm(physics, pose if before is None else before.setpoint, self._of.servo)
        if before is not None:
            arm.go_on_as(before)
            for name in before.physics.loose:
                if name in physics.loose:
                    _set_loose(arm, name, *_loose_state(before, name))
                elif (displaced := self._found(before, name)).moved > self._of.limits.stays:
                    # the arm picks up where the plan has it, but it is not there any more
                    self._displaced[name] = displaced
            for name in sorted(physics.loose.keys() - before.physics.loose.keys()):
                self._released[name] = begin
                self._before.pop(name, None)
        mujoco.mj_forward(physics.model, arm.data)
        for name in physics.loose:
            self._before.setdefault(name, _loose_state(arm, name)[0])
        return arm

    def _model(self, scene: Scene, loose: Mapping[str, str]) -> PhysicsModel:
        of = self._of
        load = Load(of.masses, loose, of.flange)
        return build_model(of.bodies, scene, of.self_collision, of.drives, load, of.gravity)

    def _watch(self, scene: Scene, physics: PhysicsModel) -> GripWatch | None:
        """Return what looks at the cups while the arm carries something in a scene; None: it does not, or there are none."""
        of = self._of
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
            self._remarks.append(Sentence("physics.remark.no_cup", object=name))
            return None
        return GripWatch(
            grip, name, physics, [item.name for item in carried], bodies.model.names[frame.parentJoint], frame.placement
        )

    def _play(
        self, arm: SimulatedArm, times: np.ndarray, setpoints: np.ndarray, watch: GripWatch | None
    ) -> float | None:
        """Play setpoints; note each cycle's torques, and every step's contacts; return when it came apart [s], None if not."""
        physics, data = arm.physics, arm.data
        limit = np.array([torque or math.inf for torque in self._of.drives.torque])
        gravity = _GravityTorque(physics)
        for at, setpoint in zip(times.tolist(), setpoints):
            lowest = highest = np.zeros(len(limit))
            for _step in arm.steps(setpoint):
                # these keep a nan
                lowest, highest = np.minimum(lowest, arm.needed), np.maximum(highest, arm.needed)
                if data.ncon:
                    self._note_contacts(physics, data, at, frozenset())
            peak = np.where(highest > -lowest, highest, lowest)
            if _is_broken(data) or not np.isfinite(peak).all():
                return at
            q = arm.q
            self._torques.append(peak)
            self._speeds.append(data.qvel[physics.joints].copy())
            self._poses.append(q)
            self._gravity.append(gravity.at(data))
            if watch is not None:
                watch.note(at, data)
            self._usages.append(float((np.abs(peak) / limit).max()))
            self._kinetic.append(gravity.kinetic(data))
            np.maximum(self._off, np.abs(q - arm.answer), out=self._off)
            if self._progress is not None:
                self._progress(at, arm)
        if watch is not None:
            self._grips.append(watch.worst())
        return None

    def _note_contacts(self, physics: PhysicsModel, data: mujoco.MjData, at: float, without: Set[str]) -> None:
        """Note what touches in this step; of two bodies that touch at several points the forces are added up."""
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
        x, y, z = self._of.bodies.root_T_base.actInv(point).tolist()
        return x, y, z

    def _named_first(self, owner: str) -> tuple[bool, bool, str]:
        """Return the order in which reports name two bodies: a link, what is carried sometime, what stands."""
        return owner not in self._of.bodies.link_joints, owner not in self._carried, owner

    def _settled(self, arm: SimulatedArm, setpoint: np.ndarray) -> tuple[LooseObject, ...]:
        """Let the arm and everything that can move come to rest, nothing asleep, and return what became of it."""
        duration = self._trajectory.duration
        # nobody has planned how far the tool is from what it has let go of at the very end
        without = {name for name, released in self._released.items() if released >= duration}
        for _ in range(round((self._of.limits.settling if arm.physics.loose else _COMING_TO_REST) / CYCLE)):
            for _step in arm.steps(setpoint):
                if arm.data.ncon:
                    self._note_contacts(arm.physics, arm.data, duration, without)
            if self._progress is not None:
                duration += CYCLE
                self._progress(duration, arm)
        found = dict(self._displaced)
        for name in arm.physics.loose:
            one = self._found(arm, name)
            limits = self._of.limits
            if name in self._released or one.moved > limits.stays or one.turned > limits.stays_turned:
                found.setdefault(name, one)
        return tuple(found.values())

    def _found(self, arm: SimulatedArm, name: str) -> LooseObject:
        """Return what has become of a loose object until now."""
        before = self._before[name]
        now, speed = _loose_state(arm, name)
        turned = 2.0 * math.acos(min(1.0, abs(float(before[3:] @ now[3:]))))
        return LooseObject(
            name,
            self._released.get(name, math.nan),
            float(np.linalg.norm(now[:3] - before[:3])),
            turned,
            float(before[2] - now[2]),
            bool(np.abs(speed).max() < STILL),
        )

    def _judged(self, named, times, objects, settle) -> RehearsalReport:
        torques, speeds, gravity = np.array(self._torques), np.array(self._speeds), np.array(self._gravity)
        limits = self._of.drives.torque
        names = self._trajectory.joint_names
        worst = int(np.argmax(self._usages))
        axes = []
        for joint, name in enumerate(names):
            at = int(np.argmax(np.abs(torques[:, joint])))
            peak = float(abs(torques[at, joint]))
            axes.append(
                AxisLoad(
                    name,
                    peak,
                    float(times[at]),
                    float(np.sqrt(np.mean(torques[:, joint] ** 2))),
                    float(abs(gravity[at, joint]) / peak) if peak else 0.0,
                    limits[joint] or 0.0,
                    "torque" in self._of.drives.estimates,
                )
            )
        payload = _worst_payload(self._payloads, self._of)
        grip = self._grips[int(np.argmax([load.usage for load in self._grips]))]
        off = int(np.argmax(self._off))
        energy = float(np.sum(np.abs(torques * speeds)) * CYCLE)
        braking = self._braking()
        report = replace(
            named, axes=tuple(axes), payload=payload, tracking=float(self._off[off]), tracking_joint=names[off], braking=braking,
            worst_time=float(times[worst]), worst_pose=tuple(map(float, self._poses[worst])),
            contacts=tuple(self._contacts.values()), objects=objects, grip=grip, energy=energy,
            duration=self._trajectory.duration, settle_took=settle, remarks=tuple(dict.fromkeys(self._remarks)),
        )  # fmt: skip
        if not has_finite_numbers(report):
            # of what is not finite nothing is too large
            return self._diverged(named, self._trajectory.duration if math.isfinite(braking.usage) else braking.time)
        robot = self._of.bodies.robot
        linear = {name for name, slides in zip(robot.joint_names, robot.linear) if slides}
        reasons = tuple(_reasons(report, self._of.limits, linear))
        return replace(report, state=FAILED if reasons else PASSED, reasons=reasons)

    def _braking(self) -> Braking:
        """Stop the arm at the moment of its largest kinetic energy, all axes in the time that the slowest needs."""
        number = int(np.argmax(self._kinetic))
        robot = self._of.bodies.robot
        speed = self._speeds[number]
        most = np.array(robot.acceleration)
        seconds = float(np.max(np.abs(speed) / most))
        if seconds <= 0.0 or not math.isfinite(seconds):
            return Braking(time=number * CYCLE)
        part = next(part for part in self._parts if part is self._parts[-1] or number * CYCLE < part.end)
        # how far the arm goes on, whatever stands in the way
        physics = self._model(part.scene, {})
        physics.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        arm = SimulatedArm(physics, self._poses[number], Servo(saturates=False))
        arm.begin_with(speed)
        begin = self._poses[number]
        flange = _flange(arm)
        usage = 0.0
        limit = np.array([torque or math.inf for torque in self._of.drives.torque])
        step = physics.model.opt.timestep
        # from `speed` to rest at a steady rate
        left = np.maximum(0.0, 1.0 - np.arange(1, round(min(seconds, _LONGEST_BRAKING) / step) + 1) * step / seconds)[
            :, None
        ]
        answers = begin + speed * seconds * (1.0 - left**2) / 2.0
        speeds = np.diff(np.vstack((begin, answers)), axis=0) / step
        accelerations = np.diff(np.vstack((speed, speeds)), axis=0) / step
        for _step in arm.follow(answers, speeds, accelerations):
            usage = float(np.maximum(usage, (np.abs(arm.needed) / limit).max()))
        if _is_broken(arm.data):
            usage = math.nan
        way = np.abs(arm.q - begin)
        joint = int(np.argmax(way))
        return Braking(
            number * CYCLE,
            seconds,
            float(np.linalg.norm(_flange(arm) - flange)),
            robot.joint_names[joint],
            float(way[joint]),
            usage,
        )


class _GravityTorque:
    """Torques that hold the arm still where it is, and its kinetic energy; in a state of its own."""

    def __init__(self, physics: PhysicsModel):
        self._physics = physics
        self._data = mujoco.MjData(physics.model)
        self._product, self._speed = np.zeros(physics.model.nv), np.zeros(physics.model.nv)

    def at(self, data: mujoco.MjData) -> np.ndarray:
        """Return the torques, shape (n,)."""
        model, own = self._physics.model, self._data
        own.qpos[:] = data.qpos
        mujoco.mj_kinematics(model, own)
        mujoco.mj_comPos(model, own)
        mujoco.mj_comVel(model, own)
        mujoco.mj_rne(model, own, 0, self._product)
        return self._physics.of_joints(self._product)

    def kinetic(self, data: mujoco.MjData) -> float:
        """Return the kinetic energy of the arm with what it carries [J]; what falls or is pushed is none of it."""
        self._speed[self._physics.joints] = data.qvel[self._physics.joints]
        self._physics.lead(self._speed)
        mujoco.mj_mulM(self._physics.model, data, self._product, self._speed)
        return 0.5 * float(self._speed @ self._product)


def _reasons(report: RehearsalReport, limits: Limits, linear: Set[str]) -> Iterator[Sentence]:
    """Yield why a rehearsal has failed; `linear`: names of prismatic joints."""
    load = report.payload
    if load.rated_mass and load.mass > load.rated_mass:
        yield Sentence("rehearsal.mass", mass=load.mass, rated=load.rated_mass)
    if load.rated_inertia and load.inertia > load.rated_inertia:
        yield Sentence("rehearsal.inertia", inertia=load.inertia, rated=load.rated_inertia)
    for place, rated in ((load.across, load.rated_across), (load.along, load.rated_along)):
        if rated and abs(place) > rated:
            yield Sentence("rehearsal.distance", distance=Quantity(place, "m"), rated=Quantity(rated, "m"))
    for axis in report.axes:
        if axis.limit and axis.usage > limits.torque:
            unit = "N" if axis.joint in linear else "Nm"
            yield Sentence(
                "rehearsal.torque",
                joint=axis_name(axis.joint),
                peak=Quantity(axis.peak, unit),
                limit=Quantity(axis.limit, unit),
                percent=axis.usage * 100.0,
                time=axis.time,
            )
    if report.braking.usage > limits.torque and not report.contacts:
        yield Sentence("rehearsal.braking", time=report.braking.time, percent=report.braking.usage * 100.0)
    if report.grip.usage > 1.0:
        grip = report.grip
        yield Sentence("rehearsal.grip", object=grip.name, time=grip.time, percent=grip.usage * 100.0, cups=grip.cups)
    for contact in report.contacts:
        yield Sentence(
            "rehearsal.contact", first=contact.first, second=contact.second, time=contact.time, force=contact.force
        )
    for one in report.objects:
        if math.isfinite(one.released):
            if one.fell > limits.stays:
                yield Sentence("rehearsal.fell", object=one.name, time=one.released, distance=one.fell * 1e3)
            elif one.moved > limits.stays or one.turned > limits.stays_turned:
                yield Sentence(
                    "rehearsal.slipped",
                    object=one.name,
                    time=one.released,
                    distance=one.moved * 1e3,
                    angle=Quantity(one.turned, "rad"),
                )
        elif one.moved > limits.stays or one.turned > limits.stays_turned:
            yield Sentence(
                "rehearsal.moved", object=one.name, distance=one.moved * 1e3, angle=Quantity(one.turned, "rad")
            )
    if report.tracking > LARGEST_TRACKING and not report.contacts:
        error = Quantity(report.tracking, "m" if report.tracking_joint in linear else "rad")
        yield Sentence("rehearsal.tracking", joint=axis_name(report.tracking_joint), error=error)


def _worst_payload(payloads: Sequence[MassProperties], of: Rehearsal) -> PayloadLoad:
    """Return the largest of each number of what the flange carries, one scene after the other, beside the arm's rating."""
    rating = of.drives.rating
    rated = PayloadLoad()
    if rating is not None:
        across, along = rating.distance or (0.0, 0.0)
        rated = PayloadLoad(
            rated_mass=rating.mass, rated_inertia=rating.inertia or 0.0, rated_across=across, rated_along=along
        )
    if not payloads:
        return rated
    bodies = of.bodies
    frame = bodies.model.frames[bodies.model.getFrameId(bodies.robot.tip_link)]
    numbers = []
    for payload in payloads:
        at_flange = payload.at(frame.placement.inverse())
        centre = at_flange.centre
        x, y, z = centre.tolist()
        about = at_flange.inertia + at_flange.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        numbers.append((at_flange.mass, math.hypot(x, y), z, float(np.linalg.eigvalsh(about).max())))
    worst = np.argmax(np.abs(numbers), axis=0)
    mass, across, along, inertia = (numbers[number][kind] for kind, number in enumerate(worst))
    estimated = any(payloads[number].estimated for number in worst)
    return replace(rated, mass=mass, estimated=estimated, across=across, along=along, inertia=inertia)


def _flange(arm: SimulatedArm) -> np.ndarray:
    """Return where the last joint's frame is, shape (3,) [m]."""
    joint = arm.physics.robot.joint_names[-1]
    return arm.data.body(f"joint\n{joint}").xpos.copy()


def _loose_state(arm: SimulatedArm, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return position (x, y, z, and the quaternion w, x, y, z) and speed of what is loose."""
    at, dof = arm.physics.loose[name], _speed_place(arm, name)
    return arm.data.qpos[at : at + 7].copy(), arm.data.qvel[dof : dof + 6].copy()


def _set_loose(arm: SimulatedArm, name: str, position: np.ndarray, speed: np.ndarray) -> None:
    at, dof = arm.physics.loose[name], _speed_place(arm, name)
    arm.data.qpos[at : at + 7], arm.data.qvel[dof : dof + 6] = position, speed


def _speed_place(arm: SimulatedArm, name: str) -> int:
    model = arm.physics.model
    return int(model.jnt_dofadr[model.joint(f"free\n{name}").id])


def _is_broken(data: mujoco.MjData) -> bool:
    """Return whether the numbers are no motion any more; MuJoCo itself starts anew then, and counts."""
    warnings = mujoco.mjtWarning
    return not np.isfinite(data.qpos).all() or any(
        data.warning[kind].number
        for kind in (warnings.mjWARN_BADQPOS, warnings.mjWARN_BADQVEL, warnings.mjWARN_BADQACC)
    )
