"""A plan, carried out by the simulated arm faster than real time, before a person approves it. SI; joints as in `PhysicsModel`.

What it finds: torques against what the drives can give, the payload against the arm's rating, contacts that the plan does not have,
how far the arm goes on when it must stop at the worst moment, and what becomes of what is let go. A plan of several segments has a
scene for each; what was let go in one goes on lying where it lies in the next.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.core.units import CYCLE
from construction_twin.physics.arm import Servo, SimulatedArm
from construction_twin.physics.drive import ArmDrives
from construction_twin.physics.mass import MassProperties
from construction_twin.physics.model import GRAVITY, Load, PhysicsModel, build_model
from construction_twin.physics.report import (
    FAILED,
    PASSED,
    AxisLoad,
    Braking,
    LooseObject,
    PayloadLoad,
    RehearsalReport,
    RehearsedContact,
    finished,
)
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
        tool: Hash of what else decides the result: tool file, drives.
        gravity: Length 3. In the root of the URDF [m/s^2].
    """

    bodies: RobotBodies
    self_collision: SelfCollision
    drives: ArmDrives
    servo: Servo = Servo()
    limits: Limits = Limits()
    masses: Mapping[str, float] = field(default_factory=dict)
    flange: MassProperties | None = None
    tool: str = ""
    gravity: tuple[float, float, float] = (0.0, 0.0, -GRAVITY)

    def of_plan(
        self, plan: Plan, scenes: Mapping[str, Scene], clock: Callable[[], float] = time.perf_counter
    ) -> RehearsalReport:
        """Rehearse a plan.

        Args:
            scenes: By hash: that of the plan, and those of its segments.
            clock: For how long it took [s].
        """
        begin = clock()
        named = RehearsalReport(plan_id=plan.id, plan_hash=plan.hash, scene=plan.scene, tool=self.tool, engine=ENGINE)
        wanted = [segment.scene for segment in plan.segments] or [plan.scene]
        missing = sorted({each for each in wanted if each not in scenes})
        if missing:
            return finished(
                replace(named, reasons=(Sentence("rehearsal.no_scene", scene=missing[0][:12]),)), clock() - begin
            )
        ends = [segment.end for segment in plan.segments] or [plan.trajectory.duration]
        parts = [Part(scenes[scene], end) for scene, end in zip(wanted, ends)]
        after = scenes.get(plan.segments[-1].scene_after) if plan.segments else None
        run = _Run(self, plan.trajectory, parts, after)
        try:
            found = run.report(named, clock)
        except mujoco.FatalError as error:
            found = replace(named, reasons=(Sentence("rehearsal.engine", problem=str(error)),))
        return finished(found, clock() - begin)


#: What simulates.
ENGINE = f"MuJoCo {mujoco.__version__}"


class _Run:
    """One rehearsal: it steps the arm through the parts, and notes."""

    def __init__(self, of: Rehearsal, trajectory: Trajectory, parts: Sequence[Part], after: Scene | None):
        self._of = of
        self._trajectory = trajectory
        self._parts = parts
        self._after = after
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
        self._remarks: list[str] = []
        self._diverged: float | None = None

    def report(self, named: RehearsalReport, clock: Callable[[], float]) -> RehearsalReport:
        times = np.arange(round(self._trajectory.duration / CYCLE) + 1) * CYCLE
        setpoints = self._trajectory.sample_many(times)[0]
        arm: SimulatedArm | None = None
        states: dict[str, np.ndarray] = {}
        first = 0
        for number, part in enumerate(self._parts):
            last = len(times) if number == len(self._parts) - 1 else round(part.end / CYCLE)
            arm = self._arm(part.scene, setpoints[first] if arm is None else None, arm, states, asleep=True)
            self._play(arm, times[first:last], setpoints[first:last])
            states = _loose_states(arm)
            first = last
            if self._diverged is not None:
                reason = Sentence("rehearsal.diverged", time=self._diverged)
                return replace(named, state=FAILED, reasons=(reason,), remarks=tuple(dict.fromkeys(self._remarks)))
        assert arm is not None
        begin = clock()
        objects = self._settled(arm, setpoints[-1])
        settle = clock() - begin
        return self._judged(named, times, objects, arm, settle)

    def _arm(self, scene, pose, before, states, asleep: bool) -> SimulatedArm:
        """Return the arm in a scene, where it stood; what was let go lies where it lay."""
        carried = {item.name for part in self._parts for item in part.scene.objects if item.link}
        tool_of_all = set.intersection(
            *({item.name for item in part.scene.objects if item.link} for part in self._parts)
        )
        loose = frozenset(({*self._of.masses} | (carried - tool_of_all)) & set(scene.names))
        physics = build_model(
            self._of.bodies, scene, self._of.self_collision, self._of.drives,
            Load(self._of.masses, loose, self._of.flange), self._of.gravity,
        )  # fmt: skip
        if asleep:
            physics.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        self._remarks += physics.remarks
        if physics.payload is not None:
            self._payloads.append(physics.payload)
        arm = SimulatedArm(physics, pose if before is None else before.setpoint, self._of.servo)
        if before is not None:
            for name in set(physics.loose) - set(before.physics.loose):
                self._released[name] = self._time
            arm.go_on_as(before)
        for name, state in states.items():
            if name in physics.loose:
                at = physics.loose[name]
                arm.data.qpos[at : at + 7] = state
        mujoco.mj_forward(physics.model, arm.data)
        for name in physics.loose:
            self._before.setdefault(name, _pose_of(arm, name))
            if name in self._released and self._released[name] == self._time:
                self._before[name] = _pose_of(arm, name)
        return arm

    _time = 0.0

    def _play(self, arm: SimulatedArm, times: np.ndarray, setpoints: np.ndarray) -> None:
        """Play setpoints; note each cycle's torques, and every step's contacts."""
        physics, data = arm.physics, arm.data
        limit = np.array([torque or math.inf for torque in self._of.drives.torque])
        gravity = _GravityTorque(physics)
        substeps = arm.steps_per_cycle
        for at, setpoint in zip(times.tolist(), setpoints):
            self._time = at
            peak = np.zeros(len(limit))
            for _ in range(substeps):
                arm.step(setpoint)
                # an arm that pushes against something pushes as hard as it can: that is the contact's, not the plan's
                needed = arm.torque if self._contacts else arm.needed
                peak = np.where(np.abs(needed) > np.abs(peak), needed, peak)
                if data.ncon:
                    self._note_contacts(physics, data, at)
            if not np.isfinite(data.qpos).all() or data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
                self._diverged = at
                return
            q = arm.q
            self._torques.append(peak)
            self._speeds.append(data.qvel[physics.joints])
            self._poses.append(q)
            self._gravity.append(gravity.at(data))
            self._usages.append(float((np.abs(peak) / limit).max()))
            self._kinetic.append(gravity.kinetic(data))
            np.maximum(self._off, np.abs(q - arm.answer), out=self._off)

    def _note_contacts(self, physics: PhysicsModel, data: mujoco.MjData, at: float) -> None:
        geoms = data.contact.geom
        wrong = np.flatnonzero(physics.unplanned[geoms[:, 0], geoms[:, 1]])
        force = np.zeros(6)
        for number in wrong.tolist():
            mujoco.mj_contactForce(physics.model, data, number, force)
            size = float(np.linalg.norm(force[:3]))
            if size < LEAST_FORCE:
                continue
            names = physics.owners[geoms[number, 0]], physics.owners[geoms[number, 1]]
            known = self._contacts.get(names) or RehearsedContact(*names, at, 0.0, 0.0)
            self._contacts[names] = replace(
                known, force=max(known.force, size), seconds=known.seconds + physics.model.opt.timestep
            )

    def _settled(self, arm: SimulatedArm, setpoint: np.ndarray) -> tuple[LooseObject, ...]:
        """Let everything that can move come to rest, nothing asleep, and return what became of it."""
        if self._after is not None:
            arm = self._arm(self._after, None, arm, _loose_states(arm), asleep=False)
        else:
            arm.physics.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
            data = arm.data
            data.qvel[:] = 0.0
            mujoco.mj_forward(arm.physics.model, data)
        if not arm.physics.loose:
            return ()
        for _ in range(round(self._of.limits.settling / CYCLE)):
            arm.cycle(setpoint)
        found = []
        for name, at in arm.physics.loose.items():
            before, now = self._before[name], _pose_of(arm, name)
            dof = arm.physics.model.jnt_dofadr[arm.physics.model.joint(f"free\n{name}").id]
            speed = np.abs(arm.data.qvel[dof : dof + 6]).max()
            turned = 2.0 * math.acos(min(1.0, abs(float(before[3:] @ now[3:]))))
            moved = float(np.linalg.norm(now[:3] - before[:3]))
            one = LooseObject(
                name, self._released.get(name, math.nan), moved, turned, float(before[2] - now[2]), bool(speed < STILL)
            )
            if name in self._released or moved > self._of.limits.stays or turned > self._of.limits.stays_turned:
                found.append(one)
        return tuple(found)

    def _judged(self, named, times, objects, arm, settle) -> RehearsalReport:
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
                )  # fmt: skip
            )
        payload = _heaviest(self._payloads, self._of)
        off = int(np.argmax(self._off))
        energy = float(np.sum(np.abs(torques * speeds)) * CYCLE)
        braking = self._braking()
        report = replace(
            named, axes=tuple(axes), payload=payload, tracking=float(self._off[off]), tracking_joint=names[off], braking=braking,
            worst_time=float(times[worst]), worst_pose=tuple(map(float, self._poses[worst])),
            contacts=tuple(self._contacts.values()), objects=objects, energy=energy, duration=self._trajectory.duration,
            settle_took=settle, remarks=tuple(dict.fromkeys(self._remarks)),
        )  # fmt: skip
        reasons = tuple(_reasons(report, self._of.limits))
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
        physics = build_model(
            self._of.bodies, part.scene, self._of.self_collision, self._of.drives,
            Load(self._of.masses, frozenset(), self._of.flange), self._of.gravity,
        )  # fmt: skip
        arm = SimulatedArm(physics, self._poses[number], Servo(omega=0.0))
        arm.begin_with(speed)
        begin = self._poses[number]
        flange = _flange(arm)
        usage = 0.0
        limit = np.array([torque or math.inf for torque in self._of.drives.torque])
        for count in range(1, round(min(seconds, _LONGEST_BRAKING) / physics.model.opt.timestep) + 1):
            left = max(0.0, 1.0 - count * physics.model.opt.timestep / seconds)
            # from `speed` to rest at a steady rate
            arm.step(begin + speed * seconds * (1.0 - left * left) / 2.0)
            usage = max(usage, float((np.abs(arm.needed) / limit).max()))
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
        self._product = np.zeros(physics.model.nv)

    def at(self, data: mujoco.MjData) -> np.ndarray:
        """Return the torques, shape (n,)."""
        model, own = self._physics.model, self._data
        own.qpos[:] = data.qpos
        mujoco.mj_kinematics(model, own)
        mujoco.mj_comPos(model, own)
        mujoco.mj_comVel(model, own)
        mujoco.mj_rne(model, own, 0, self._product)
        return self._product[self._physics.joints].copy()

    def kinetic(self, data: mujoco.MjData) -> float:
        """Return the kinetic energy of everything that moves [J]."""
        mujoco.mj_mulM(self._physics.model, data, self._product, data.qvel)
        return 0.5 * float(data.qvel @ self._product)


def _reasons(report: RehearsalReport, limits: Limits):
    """Yield why a rehearsal has failed."""
    load = report.payload
    if load.rated_mass and load.mass > load.rated_mass:
        yield Sentence("rehearsal.mass", mass=load.mass, rated=load.rated_mass)
    if load.rated_inertia and load.inertia > load.rated_inertia:
        yield Sentence("rehearsal.inertia", inertia=load.inertia, rated=load.rated_inertia)
    for axis in report.axes:
        if axis.limit and axis.usage > limits.torque:
            yield Sentence(
                "rehearsal.torque",
                joint=axis.joint,
                peak=axis.peak,
                limit=axis.limit,
                percent=axis.usage * 100.0,
                time=axis.time,
            )
    if report.braking.usage > limits.torque and not report.contacts:
        yield Sentence("rehearsal.braking", time=report.braking.time, percent=report.braking.usage * 100.0)
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
        yield Sentence("rehearsal.tracking", joint=report.tracking_joint, error=Quantity(report.tracking, "rad"))


def _heaviest(payloads: Sequence[MassProperties], of: Rehearsal) -> PayloadLoad:
    """Return the heaviest of what the flange carries beside the arm's rating."""
    rating = of.drives.rating
    rated = PayloadLoad()
    if rating is not None:
        across, along = rating.distance or (0.0, 0.0)
        rated = PayloadLoad(
            rated_mass=rating.mass, rated_inertia=rating.inertia or 0.0, rated_across=across, rated_along=along
        )
    if not payloads:
        return rated
    heaviest = max(payloads, key=lambda one: one.mass)
    bodies = of.bodies
    frame = bodies.model.frames[bodies.model.getFrameId(bodies.robot.tip_link)]
    at_flange = heaviest.at(frame.placement.inverse())
    x, y, z = at_flange.centre
    centre = at_flange.centre
    about = at_flange.inertia + at_flange.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return replace(
        rated, mass=at_flange.mass, estimated=heaviest.estimated, across=math.hypot(x, y), along=float(z),
        inertia=float(np.linalg.eigvalsh(about).max()),
    )  # fmt: skip


def _flange(arm: SimulatedArm) -> np.ndarray:
    """Return where the last joint's frame is, shape (3,) [m]."""
    joint = arm.physics.robot.joint_names[-1]
    return arm.data.body(f"joint\n{joint}").xpos.copy()


def _loose_states(arm: SimulatedArm) -> dict[str, np.ndarray]:
    """Return positions of what is loose, by name: x, y, z, and the quaternion w, x, y, z."""
    return {name: arm.data.qpos[at : at + 7].copy() for name, at in arm.physics.loose.items()}


def _pose_of(arm: SimulatedArm, name: str) -> np.ndarray:
    at = arm.physics.loose[name]
    return arm.data.qpos[at : at + 7].copy()
