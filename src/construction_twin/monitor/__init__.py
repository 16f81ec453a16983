"""Algorithm 1 of the paper as a gate in the command path.

In: next setpoints, poses of the twin and of the physical arm, the state of plan and link. Out: the setpoints that may pass, the
gate's state, its transitions and their log, and requests for a new plan. May import ``core``, ``servo``, ``review``
and ``mqtt``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.monitor.comparison import Comparison as Comparison
    from construction_twin.monitor.comparison import ComparisonSettings as ComparisonSettings
    from construction_twin.monitor.comparison import PoseComparison as PoseComparison
    from construction_twin.monitor.comparison import TwinHistory as TwinHistory
    from construction_twin.monitor.comparison import undetected as undetected
    from construction_twin.monitor.gate import Gate as Gate
    from construction_twin.monitor.gate import GateSettings as GateSettings
    from construction_twin.monitor.gate import WatchedArm as WatchedArm
    from construction_twin.monitor.lag import LagEstimate as LagEstimate
    from construction_twin.monitor.replan import ReplanGoal as ReplanGoal
    from construction_twin.monitor.replan import ReplanGoals as ReplanGoals
    from construction_twin.monitor.round_trip import RoundTrips as RoundTrips
    from construction_twin.monitor.servo_watch import ServoWatch as ServoWatch
    from construction_twin.monitor.settings import Behaviour as Behaviour
    from construction_twin.monitor.states import SyncEvent as SyncEvent
    from construction_twin.monitor.states import SyncState as SyncState
    from construction_twin.monitor.states import Transition as Transition
    from construction_twin.monitor.torque_watch import TorqueSettings as TorqueSettings
    from construction_twin.monitor.torque_watch import TorqueWatch as TorqueWatch
    from construction_twin.monitor.transition_log import TransitionLog as TransitionLog
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
