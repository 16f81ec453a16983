"""neighbour: says on `conflict` whether the plan that our arm plays, else its newest, meets the other arm."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import rosgraph
import rospy

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Sentence
from construction_twin.msg import Conflict as ConflictMsg
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan
from construction_twin.ros.messages.records import with_sentences
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.arm_listener import (
    ARM_POSES,
    ARM_TOPICS,
    ArmListener,
    Claim,
    NeighbourSettings,
    NeighbourUnknownError,
    OtherArm,
    await_robot,
    listen_to_other_arm,
    plan_rows,
)
from construction_twin.ros.shared.diagnostics import OK, WARN, Diagnosis
from construction_twin.ros.transport.publisher import AnyPublisher
from construction_twin.scene.collision_world import CollisionWorld, Contact
from construction_twin.scene.neighbour import Obstacle, key_rows
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision

#: Checks per second. The executor takes a verdict for 0.5 s.
RATE = 10.0


def first_meeting(
    world: CollisionWorld, plan: Plan, obstacles: Iterable[Obstacle], padding: float
) -> tuple[float, Contact] | None:
    """Return when a plan first comes too close to the other arm [s] and what does, None if nothing does.

    Poses are checked between which no point moves further than the padding, and half of that is kept besides a quarter: a plan
    made with the whole padding is free. `world`: of our arm with all that it will carry.
    """
    combined = world.with_neighbour((item.padded(0.75 * padding) for item in obstacles), alone=True)
    times, qs = plan_rows(plan)
    rows = key_rows(np.append(0.0, np.cumsum(np.abs(np.diff(qs, axis=0)) @ combined.levers)), padding)
    index = combined.all_free(qs[rows])
    if index is None:
        return None
    contact = combined.contact(qs[rows[index]])
    assert contact is not None, "all_free and contact disagree"
    return float(times[rows[index]]), contact


class NeighbourNode:
    """Two arms' topics in, verdicts on a plan of ours out."""

    def __init__(
        self, own: ArmListener, other: OtherArm, world: CollisionWorld, padding: float, conflict: AnyPublisher
    ):
        self._own = own
        self._other = other
        self._world = world
        self._padding = padding
        self._publisher = conflict
        self._state = Diagnosis(WARN, "no plan yet")
        self._checked: tuple[Plan, Scene, tuple[Obstacle, ...]] | None = None
        self._met: tuple[float, Contact] | None = None
        self._logged: tuple[str, str] | None = None

    def run(self) -> None:
        """Check again and again, in the main thread: an unexpected exception ends the process, which is then started anew."""
        rate = rospy.Rate(RATE)
        while not rospy.is_shutdown():
            self.check()
            rate.sleep()

    def check(self) -> None:
        """Publish the verdict on the plan that is played, else on our newest."""
        try:
            own = self._own.claim()
            plan = self._own.newest if own is None else self._own.plan(own.plan_id)
        except NeighbourUnknownError as error:
            # whether it is played is not known: without a word nothing starts, and nothing stops
            self._state = Diagnosis(WARN, str(error))
            return
        if plan is None:
            return
        try:
            problem = self._obstacle(plan, own)
        except ConstructionTwinError as error:
            problem = str(error)
        self._publish(plan, problem)
        sentence = problem or "its path is free"
        self._state = Diagnosis(WARN if problem else OK, sentence)
        if self._logged != (plan.id, problem):
            self._logged = plan.id, problem
            (rospy.logwarn if problem else rospy.loginfo)("plan %s: %s", plan.id, sentence)

    def _publish(self, plan: Plan, problem: str) -> None:
        message = ConflictMsg(plan_id=plan.id, conflict=bool(problem), reason=problem)
        self._publisher.publish(with_sentences(message, problem))

    def _obstacle(self, plan: Plan, own: Claim | None) -> str:
        """Return why a plan must not start, or go on: it meets the other arm's earlier plan, or that arm where it stands; or ""."""
        scene, plays = self._own.scene, own is not None and own.plan_id == plan.id
        try:
            occupied = self._other.occupied()
        except NeighbourUnknownError:
            if plays:
                return ""
            raise
        if own is not None and plays and occupied.claim is not None and own < occupied.claim:
            return ""
        if scene is None:
            return "" if plays else Sentence("our own scene, with what the arm carries, was not received")
        inputs = plan, scene, occupied.obstacles
        if self._checked is None or any(one is not other for one, other in zip(inputs, self._checked)):
            if occupied.claim is not None and not plays:
                # this takes about a second, in which no earlier word may start it
                self._publish(
                    plan, Sentence("its path is being compared with a plan of the other arm; approve it after that")
                )
            world = self._world.with_scene(self._own.carrying(plan, scene))
            self._met, self._checked = first_meeting(world, plan, occupied.obstacles, self._padding), inputs
            if self._other.claim() != occupied.claim:
                # one of its plans was approved, or ended, during the comparison
                return self._obstacle(plan, self._own.claim())
        if self._met is None:
            return ""
        seconds, contact = self._met
        mine, theirs = contact.between
        too_close = Sentence(
            "{mine} would come too close to {theirs} in {seconds:.1f} s", mine=mine, theirs=theirs, seconds=seconds
        )
        return Sentence(
            "{contact}, which stands there" if occupied.claim is None else "{contact}, which follows an approved plan",
            contact=too_close,
        )

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        return self._state


def start(settings: NeighbourSettings, robot: RobotModel, node_io: shell.NodeIO) -> NeighbourNode:
    """Return the watch with its parameters and topics."""
    refuse = node_io.diagnostics.refuse
    await_robot(settings.name)
    other = listen_to_other_arm(robot.name, settings, refuse)
    own = ArmListener(robot, rosgraph.names.namespace(rospy.get_namespace()), refuse)
    world = CollisionWorld(robot, Scene(()), SelfCollision({}, ""))
    return NeighbourNode(own, other, world, settings.padding, node_io.publishers["conflict"])


INTERFACE = shell.Interface(
    diagnose=NeighbourNode.diagnose,
    publishes=(shell.Publication("conflict", ConflictMsg, queue_size=10),),
    listeners=(*ARM_TOPICS, *ARM_POSES),
)
NODE = shell.NodeShell("neighbour", NeighbourSettings, start, INTERFACE)
main = NODE.run
