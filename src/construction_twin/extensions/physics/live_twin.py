"""The twin with mass: one cycle of the simulated arm per command, in the scene of the moment. A `TwinBackend`.

Models are built elsewhere; `set_model` may be called from any thread. The same cycles in the same models give the same bytes.
"""

from __future__ import annotations

from collections import deque

import mujoco
import numpy as np

from construction_twin.extensions.physics.arm import Servo, SimulatedArm, is_broken
from construction_twin.extensions.physics.model import PhysicsModel


class LiveTwin:
    """An arm with mass that follows what is commanded; before the first model it is where it is told to be.

    Attributes:
        effort: What the axes gave in the last step [N m], [N]; empty before the first model.
        contacts: Pairs of links and objects that touched at the end of the last cycle, and that the planner would have refused.
        diverged: How often the state became useless and the arm was put at rest at the commanded pose.
    """

    def __init__(self, servo: Servo = Servo(holds=True)):
        self._servo = servo
        self._arm: SimulatedArm | None = None
        self._model: PhysicsModel | None = None
        #: The newest model, until a cycle takes it.
        self._next: deque[PhysicsModel] = deque(maxlen=1)
        self.effort: tuple[float, ...] = ()
        self.contacts: tuple[tuple[str, str], ...] = ()
        self.diverged = 0

    @property
    def fault(self) -> str:
        """Why what is shown is not a simulation, or was begun anew; empty: it is one."""
        if self._model is None and not self._next:
            return "nothing is simulated before the scene is known: the twin is where it is told to be"
        anew = "the simulation was begun anew at the commanded pose, because its numbers had become useless"
        return f"{anew}: {self.diverged} times so far" if self.diverged else ""

    def set_model(self, model: PhysicsModel) -> None:
        """Continue in another model from the next cycle on, with the pose, speed and servo state of that moment."""
        self._next.append(model)

    def restart(self) -> None:
        """Forget where the arm is: the next cycle begins at rest, at the pose that is commanded then."""
        self._arm, self.effort, self.contacts = None, (), ()

    def cycle(self, commanded: tuple[float, ...]) -> tuple[float, ...]:
        """Advance one cycle towards the commanded pose; return the simulated one at its end, both of shape (n,)."""
        self._enter_model(commanded)
        arm = self._arm
        if arm is None:
            return commanded
        arm.cycle(np.array(commanded))
        if is_broken(arm.data):
            self.diverged += 1
            self.restart()
            return commanded
        self.effort = tuple(arm.torque.tolist())
        self.contacts = _touching(arm) if arm.data.ncon else ()
        return tuple(arm.q.tolist())

    def _enter_model(self, commanded: tuple[float, ...]) -> None:
        """Have an arm in the newest model: a new one stands where it is commanded to be, or goes on as the one before."""
        if self._next:
            before, model = self._arm, self._next.pop()
            self._model = model
            self._arm = SimulatedArm(model, commanded if before is None else before.q, self._servo)
            if before is not None:
                self._arm.continue_from(before)
                mujoco.mj_forward(model.model, self._arm.data)
        elif self._arm is None and self._model is not None:
            self._arm = SimulatedArm(self._model, commanded, self._servo)


def _touching(arm: SimulatedArm) -> tuple[tuple[str, str], ...]:
    physics, contact = arm.physics, arm.data.contact
    # from the margin on MuJoCo lists what comes near
    near = contact.geom[contact.dist <= 0.0]
    wrong = near[physics.unplanned[near[:, 0], near[:, 1]]]
    pairs = {(physics.owners[first], physics.owners[second]) for first, second in wrong.tolist()}
    return tuple(sorted(pairs))
