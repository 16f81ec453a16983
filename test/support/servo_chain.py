"""The chain with a model of the arm's servos at the gate: motions, faults, and an arm that is not of the model's class.

Angles in rad. Shared by tests and by the benchmark `monitor`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from chain_samples import ROBOT, ROOT, SETTINGS, make_plan
from inverse_dynamics import InverseDynamics
from simulation import SimulatedChain

from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS
from construction_twin.extensions.physics.commands.identify import recorded_motions
from construction_twin.extensions.physics.drive import drives_of as urdf_drives
from construction_twin.extensions.physics.drive import read_drives
from construction_twin.extensions.physics.identification import IdentifiedJoint, identify
from construction_twin.extensions.physics.mass import payload_of
from construction_twin.extensions.physics.mock_servo import PhysicsServo, Plant, bare_model
from construction_twin.mock.faults import Fault
from construction_twin.mock.program import MockSettings, build_controller
from construction_twin.mock.servo import RealisticServo, Servo
from construction_twin.monitor.states import SyncState, Transition
from construction_twin.robot.plan import Plan
from construction_twin.ros.nodes.rsi_gateway import gateway_config
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.servo.model import JointServo, ServoModel, transition_matrix

NAMES = ROBOT.joint_names
#: The mock's servos as they are set.
NOMINAL = ServoModel(NAMES, (JointServo(60.0, 0.8),) * len(NAMES), CYCLE_NS)
DRIVES = str(ROOT / "config/kr120_drives.yaml")
#: How far single joints go from the home pose at their fastest [rad].
SWEEP = (2.4, 1.2, -1.4, 3.0, -3.0, 3.0)
#: How far random poses lie from the home pose at most [rad].
ROOM = np.array((1.5, 0.6, 0.6, 1.5, 1.0, 2.0))


def servo_chain(
    model: ServoModel | None = NOMINAL, servo: str = "realistic", arm: Servo | None = None, **mock
) -> SimulatedChain:
    """Return a chain that is ready for a plan; `mock` are settings of the mock, `arm` stands in its place."""
    config = gateway_config(ROBOT, SETTINGS | {"decimals": 3})
    values = {"gateway_host": "simulated", "gateway_port": 1, "servo": servo, "drives": DRIVES} | mock
    controller = build_controller(MockSettings(**values), ROBOT)
    if arm is not None:
        arm.reset(controller.measured)
        controller.servo = arm
    chain = SimulatedChain(ROBOT, config, controller, servos=model)
    assert chain.run_until(lambda: chain.ready, 5.0), chain.gate.reason
    chain.run_for(0.5)
    return chain


def poses(seed: int) -> Iterator[np.ndarray]:
    """Yield random poses around the home pose."""
    numbers, home = np.random.default_rng(seed), np.array(ROBOT.home)
    lower, upper = np.array(ROBOT.lower) + 0.05, np.array(ROBOT.upper) - 0.05
    while True:
        yield np.clip(home + numbers.uniform(-1.0, 1.0, len(home)) * ROOM, lower, upper)


def sweep(chain: SimulatedChain, joint: int) -> tuple[Plan, float, float]:
    """Return a plan on which one joint is as fast as plans get, when that is [s], and how fast [rad/s]."""
    goal = np.array(chain.twin.pose)
    goal[joint] += SWEEP[joint]
    plan = make_plan(chain, goal)
    speeds = np.abs(plan.trajectory.sample_many(np.arange(0.0, plan.trajectory.duration, CYCLE))[1][:, joint])
    return plan, float(speeds.argmax()) * CYCLE, float(speeds.max())


def fault_in_motion(model: ServoModel | None, joint: int, fault: Fault, share: float = 1.0) -> tuple[int | None, str]:
    """Let a joint have a fault while it moves.

    Args:
        share: Of the plan's fastest moment: earlier, and slower.

    Returns:
        Which pose with the fault closed the gate, counted from 1, or None when the gate was open 0.4 s later; and why.
    """
    chain = servo_chain(model)
    plan, fastest, _ = sweep(chain, joint)
    chain.play(plan)
    # what the controller plays is later than what is commanded
    chain.run_for(share * fastest + 0.03)
    before = len(chain.feedback)
    chain.faults.inject(fault)
    if not chain.run_until(lambda: chain.gate.state is not SyncState.IN_SYNC, 0.4):
        return None, ""
    arrived = len(chain.feedback) - before
    return arrived - _unaffected(chain, before, joint, fault), chain.transitions[-1].reason


def _unaffected(chain: SimulatedChain, before: int, joint: int, fault: Fault) -> int:
    """Return how many of the poses after `before` do not show the fault yet."""
    positions = [sample[1][joint] for sample in chain.feedback[before - 2 :]]
    steps = np.diff(positions)
    usual = steps[0]
    for number, step in enumerate(steps[1:]):
        stopped = fault.name == "stall" and abs(step) < 0.02 * abs(usual)
        jumped = fault.name != "stall" and abs(step - usual) > 0.5 * abs(fault.values[0])
        if stopped or jumped:
            return number
    raise AssertionError("the fault shows in no pose")


def identified(chain: SimulatedChain) -> tuple[IdentifiedJoint, ...]:
    """Return the servos as they follow from what a bag of the chain's run would hold."""
    recording = chain.recording()
    return identify(NAMES, recorded_motions(replace(recording, command=recording.twin), CYCLE_NS), CYCLE_NS)


def model_of(found: tuple[IdentifiedJoint, ...]) -> ServoModel:
    """Return the model of what was identified."""
    return ServoModel(NAMES, tuple(joint.servo for joint in found), CYCLE_NS)


class LadenServo(RealisticServo):
    """The mock's realistic servo, which may carry something: that makes it softer."""

    def carry(self, softer: float) -> None:
        """Let the frequency fall by a fraction."""
        self._transition = transition_matrix(60.0 * (1.0 - softer), 0.8, CYCLE)


class ForeignPlant(Plant):
    """An arm that its own servos do not know: friction, and a payload that nobody told them of.

    Both act as torques from outside, so that the servos hold against them only with their stiffness, which has no integral part.

    Args:
        mass: Payload that the servos do not know, 0.2 m before the flange [kg]; see `laden`.
        friction: Of each axis, as a fraction of what its drive can give.

    Attributes:
        laden: Whether the arm has the payload now.
    """

    def __init__(self, mass: float, friction: float):
        drives, bodies = read_drives(DRIVES, ROBOT), RobotBodies(ROBOT)
        known = bare_model(bodies, drives)
        self._rubbing = friction * np.array(drives.torque)
        plain = urdf_drives(ROBOT)
        self._full = InverseDynamics(bare_model(bodies, plain, payload_of([mass, 0.0, 0.0, 0.2], "payload")))
        self._bare = InverseDynamics(bare_model(bodies, plain))
        self.laden = True
        super().__init__(known, 60.0, 0.8)

    def place(self, q) -> None:
        super().place(q)
        self._answer, self._speed = self._arm.answer, np.zeros(len(NAMES))

    def cycle(self, setpoint: np.ndarray, cycles: int = 1) -> None:
        # of the motion that the servos want: torques from the measured acceleration would be another control loop
        speed = (self._arm.answer - self._answer) / CYCLE
        growth = (speed - self._speed) / CYCLE
        self._answer, self._speed = self._arm.answer, speed
        torque = -self._rubbing * np.clip(speed / 0.005, -1.0, 1.0)
        if self.laden:
            torque -= self._full.torques(self.q, speed, growth) - self._bare.torques(self.q, speed, growth)
        for joint, each in enumerate(torque.tolist()):
            self.push(joint, each)
        super().cycle(setpoint, cycles)


def servo_of(plant: ForeignPlant) -> Servo:
    """Return the axes of the mock that such an arm is moved by."""
    return PhysicsServo(plant, ROBOT, math.radians(3e-5))


class Work:
    """Lets a chain move for a long time, and keeps of it only figures."""

    def __init__(self, chain: SimulatedChain, seed: int):
        self.chain = chain
        self._poses = poses(seed)
        self._sum, self._count = np.zeros(len(NAMES)), 0
        #: Changes of the gate's state, oldest first.
        self.changes: list[Transition] = []

    def run(self, duration: float, between: Callable[[int], object] = lambda number: None, **timing) -> None:
        """Move from pose to pose until `duration` [s] have passed; `between` is called with the number of each plan, at rest."""
        chain, begin, number = self.chain, self.chain.now, 0
        while chain.now - begin < duration * NANOSECONDS:
            between(number)
            plan = make_plan(chain, next(self._poses), **timing)
            chain.play(plan)
            done = chain.run_until(
                lambda: chain.executor.outcome != "" or chain.gate.state is not SyncState.IN_SYNC,
                plan.trajectory.duration + 5.0,
            )
            assert done, chain.executor.reason
            chain.run_for(0.6)
            self._take()
            number += 1
            if chain.gate.state is not SyncState.IN_SYNC or self.holds:
                return

    @property
    def holds(self) -> list[str]:
        """Why the gate closed, each time."""
        left = [change for change in self.changes if change.source is SyncState.IN_SYNC is not change.target]
        return [str(change) for change in left]

    @property
    def largest(self) -> np.ndarray:
        """Largest residual of a pose that was judged and agreed, since this was set to zero last, shape (n,)."""
        return np.array(self.chain.gate.servo_watch.largest)

    def forget(self) -> None:
        """Begin anew with `largest`."""
        self.chain.gate.servo_watch.largest = (0.0,) * len(NAMES)

    @property
    def average(self) -> np.ndarray:
        """Mean absolute residual, shape (n,)."""
        return self._sum / max(1, self._count)

    def _take(self) -> None:
        """Add up what the last motion left, and forget it."""
        chain = self.chain
        measured = {sample[0]: sample[1] for sample in chain.feedback}
        pairs = [(measured[stamp], pose) for stamp, pose in chain.expected if stamp in measured]
        if pairs:
            residual = np.abs(np.array([each[0] for each in pairs]) - np.array([each[1] for each in pairs]))
            self._sum += residual.sum(axis=0)
            self._count += len(residual)
        self.changes += chain.transitions
        for kept in (
            chain.feedback,
            chain.expected,
            chain.twin_poses,
            chain.measured,
            chain.corrections,
            chain.transitions,
        ):
            kept.clear()


def slip(joint: int, angle: float) -> Fault:
    """Return a slip of a joint [deg]."""
    return Fault("offset", ROBOT.axes[joint].name, (math.radians(angle),))
