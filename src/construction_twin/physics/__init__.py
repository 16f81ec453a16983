"""The arm with mass: a MuJoCo model of arm, load and scene, and the rehearsal of a plan in it.

In: a robot, a scene, masses, drives, a plan. Out: torques, contacts, what falls. Needs the set-up's group ``physics``. May import
``core``, ``robot``, ``kinematics``, ``scene``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.physics.arm import Servo as Servo
    from construction_twin.physics.arm import SimulatedArm as SimulatedArm
    from construction_twin.physics.drive import ArmDrives as ArmDrives
    from construction_twin.physics.drive import PayloadRating as PayloadRating
    from construction_twin.physics.drive import drives_of as drives_of
    from construction_twin.physics.drive import load_drives as load_drives
    from construction_twin.physics.drive import read_drives as read_drives
    from construction_twin.physics.gazebo_world import GazeboWorld as GazeboWorld
    from construction_twin.physics.gazebo_world import world_of as world_of
    from construction_twin.physics.live_twin import LiveTwin as LiveTwin
    from construction_twin.physics.mass import MassProperties as MassProperties
    from construction_twin.physics.model import Load as Load
    from construction_twin.physics.model import PhysicsModel as PhysicsModel
    from construction_twin.physics.model import build_model as build_model
    from construction_twin.physics.plant import InverseDynamics as InverseDynamics
    from construction_twin.physics.plant import Plant as Plant
    from construction_twin.physics.plant import bare_model as bare_model
    from construction_twin.physics.rehearsal import Rehearsal as Rehearsal
    from construction_twin.physics.report import RehearsalReport as RehearsalReport
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
