"""Units, errors, motion limits, files, real-time scheduling, network addresses and travel times.

In: numbers, stamps and texts from any other folder. Out: converted values, typed errors, motion checks, bounded motion of one
joint (``follower``), cubic interpolation, state machines as a table and its runner (``state_table``), limits on how often
(``rate_limit``), where the package's files are (``share``), the names of a folder (``exports``). May import the standard library
only, because the cell PC has nothing else.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.core.clock import MONOTONIC as MONOTONIC
    from construction_twin.core.clock import Clock as Clock
    from construction_twin.core.errors import ConfigurationError as ConfigurationError
    from construction_twin.core.errors import ConstructionTwinError as ConstructionTwinError
    from construction_twin.core.errors import ExecutionError as ExecutionError
    from construction_twin.core.errors import ExpiredError as ExpiredError
    from construction_twin.core.errors import GoalError as GoalError
    from construction_twin.core.errors import GoalJointsError as GoalJointsError
    from construction_twin.core.errors import MotionRefused as MotionRefused
    from construction_twin.core.errors import PayloadError as PayloadError
    from construction_twin.core.errors import PoseUnknownError as PoseUnknownError
    from construction_twin.core.errors import ProtocolError as ProtocolError
    from construction_twin.core.errors import RecordError as RecordError
    from construction_twin.core.errors import RequestRefused as RequestRefused
    from construction_twin.core.errors import ReviewError as ReviewError
    from construction_twin.core.errors import ScenarioError as ScenarioError
    from construction_twin.core.errors import SilenceError as SilenceError
    from construction_twin.core.errors import TelegramError as TelegramError
    from construction_twin.core.errors import TransitionLogError as TransitionLogError
    from construction_twin.core.files import check_writable as check_writable
    from construction_twin.core.files import read_file as read_file
    from construction_twin.core.files import write_whole as write_whole
    from construction_twin.core.follower import Follower as Follower
    from construction_twin.core.follower import braking_step as braking_step
    from construction_twin.core.freshness import Moment as Moment
    from construction_twin.core.freshness import is_newer as is_newer
    from construction_twin.core.freshness import parse_moment as parse_moment
    from construction_twin.core.freshness import staleness as staleness
    from construction_twin.core.histogram import Histogram as Histogram
    from construction_twin.core.histogram import percentile as percentile
    from construction_twin.core.interpolation import interpolate as interpolate
    from construction_twin.core.limits import MotionCheck as MotionCheck
    from construction_twin.core.limits import MotionLimits as MotionLimits
    from construction_twin.core.limits import braking_distance as braking_distance
    from construction_twin.core.limits import outside_tolerance as outside_tolerance
    from construction_twin.core.motion_errors import BranchError as BranchError
    from construction_twin.core.motion_errors import CartesianPathError as CartesianPathError
    from construction_twin.core.motion_errors import CollisionError as CollisionError
    from construction_twin.core.motion_errors import DurationError as DurationError
    from construction_twin.core.motion_errors import EngagedError as EngagedError
    from construction_twin.core.motion_errors import FarWaypointError as FarWaypointError
    from construction_twin.core.motion_errors import FrameError as FrameError
    from construction_twin.core.motion_errors import JointRangeError as JointRangeError
    from construction_twin.core.motion_errors import KinematicsError as KinematicsError
    from construction_twin.core.motion_errors import LimitError as LimitError
    from construction_twin.core.motion_errors import NeighbourUnknownError as NeighbourUnknownError
    from construction_twin.core.motion_errors import NoPathError as NoPathError
    from construction_twin.core.motion_errors import NoSceneError as NoSceneError
    from construction_twin.core.motion_errors import NotFoundError as NotFoundError
    from construction_twin.core.motion_errors import OrientationError as OrientationError
    from construction_twin.core.motion_errors import PlanningError as PlanningError
    from construction_twin.core.motion_errors import PlanSizeError as PlanSizeError
    from construction_twin.core.motion_errors import PoseRangeError as PoseRangeError
    from construction_twin.core.motion_errors import PositionRangeError as PositionRangeError
    from construction_twin.core.motion_errors import SceneChangedError as SceneChangedError
    from construction_twin.core.motion_errors import SceneError as SceneError
    from construction_twin.core.motion_errors import SegmentError as SegmentError
    from construction_twin.core.motion_errors import TrajectoryError as TrajectoryError
    from construction_twin.core.motion_errors import UnreachableError as UnreachableError
    from construction_twin.core.motion_errors import UnreachableOrientationError as UnreachableOrientationError
    from construction_twin.core.motion_errors import WaypointsError as WaypointsError
    from construction_twin.core.motion_errors import WaypointTimesError as WaypointTimesError
    from construction_twin.core.rate_limit import Pace as Pace
    from construction_twin.core.rate_limit import RollingWindow as RollingWindow
    from construction_twin.core.rate_limit import SenderLimits as SenderLimits
    from construction_twin.core.rate_limit import TokenBucket as TokenBucket
    from construction_twin.core.records import document as document
    from construction_twin.core.records import dumped as dumped
    from construction_twin.core.reports import ExecutionReport as ExecutionReport
    from construction_twin.core.reports import LinkReport as LinkReport
    from construction_twin.core.reports import SwitchReport as SwitchReport
    from construction_twin.core.reports import SwitchState as SwitchState
    from construction_twin.core.reports import SyncReport as SyncReport
    from construction_twin.core.reports import TaskReport as TaskReport
    from construction_twin.core.reports import ToolReport as ToolReport
    from construction_twin.core.reports import WorkReport as WorkReport
    from construction_twin.core.share import share_file as share_file
    from construction_twin.core.side_effects import SideEffects as SideEffects
    from construction_twin.core.speed_limit import LimitState as LimitState
    from construction_twin.core.speed_limit import SpeedLimit as SpeedLimit
    from construction_twin.core.state_table import Machine as Machine
    from construction_twin.core.state_table import Occasion as Occasion
    from construction_twin.core.state_table import Row as Row
    from construction_twin.core.state_table import Rows as Rows
    from construction_twin.core.state_table import cells as cells
    from construction_twin.core.travel_time import StateCheck as StateCheck
    from construction_twin.core.travel_time import TravelTime as TravelTime
    from construction_twin.core.udp import address_of as address_of
    from construction_twin.core.udp import bind as bind
    from construction_twin.core.udp import receive as receive
    from construction_twin.core.units import degrees as degrees
    from construction_twin.core.units import for_people as for_people
    from construction_twin.core.units import from_wire as from_wire
    from construction_twin.core.units import radians as radians
    from construction_twin.core.units import to_wire as to_wire
    from construction_twin.core.validation import configuration_error as configuration_error
    from construction_twin.core.validation import wrong_value as wrong_value
    from construction_twin.core.work_errors import BodyError as BodyError
    from construction_twin.core.work_errors import BuildingError as BuildingError
    from construction_twin.core.work_errors import LedgerError as LedgerError
    from construction_twin.core.work_errors import PlacementError as PlacementError
    from construction_twin.core.work_errors import ScheduleError as ScheduleError
    from construction_twin.core.work_errors import TaskPlanningError as TaskPlanningError
    from construction_twin.core.work_errors import WorkError as WorkError
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
