"""Work from a building model: which element the arm places when, from where, in which grip, and what has been built so far.

In: a building model read from IFC, a cell file, tool and recipe files, the scene, the ledger of what was done. Out: checked
segments of a work plan, or why a task cannot be done; the state of every task. Only ``work/ifc`` knows ifcopenshell. May import
``core``, ``robot``, ``kinematics``, ``scene``, ``physics``, ``planning`` and ``review``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.work.build_report import write_report as write_report
    from construction_twin.work.building import Body as Body
    from construction_twin.work.building import BuildingModel as BuildingModel
    from construction_twin.work.building import Element as Element
    from construction_twin.work.building import Extrusion as Extrusion
    from construction_twin.work.building import Sequence as Sequence
    from construction_twin.work.building import Task as Task
    from construction_twin.work.built import as_built as as_built
    from construction_twin.work.check import CheckedTask as CheckedTask
    from construction_twin.work.check import Checker as Checker
    from construction_twin.work.element_bodies import element_shapes as element_shapes
    from construction_twin.work.events import Entry as Entry
    from construction_twin.work.jobs import TaskMotions as TaskMotions
    from construction_twin.work.jobs import WorkJob as WorkJob
    from construction_twin.work.ledger import Ledger as Ledger
    from construction_twin.work.motions import TaskLimits as TaskLimits
    from construction_twin.work.placement import Placement as Placement
    from construction_twin.work.placement import check_placement as check_placement
    from construction_twin.work.proposed_schedule import ProposedSchedule as ProposedSchedule
    from construction_twin.work.proposed_schedule import is_proposal as is_proposal
    from construction_twin.work.proposed_schedule import propose as propose
    from construction_twin.work.recipe import Recipe as Recipe
    from construction_twin.work.recipes import Recipes as Recipes
    from construction_twin.work.recipes import read_recipes as read_recipes
    from construction_twin.work.schedule import Blocker as Blocker
    from construction_twin.work.schedule import Job as Job
    from construction_twin.work.schedule import Schedule as Schedule
    from construction_twin.work.schedule import Wait as Wait
    from construction_twin.work.site import CellFile as CellFile
    from construction_twin.work.site import Site as Site
    from construction_twin.work.site import pose_of as pose_of
    from construction_twin.work.site import read_site as read_site
    from construction_twin.work.site_scene import Layout as Layout
    from construction_twin.work.task_board import Prepared as Prepared
    from construction_twin.work.task_board import TaskBoard as TaskBoard
    from construction_twin.work.task_board import WorkRefused as WorkRefused
    from construction_twin.work.task_planner import TaskPlanner as TaskPlanner
    from construction_twin.work.task_states import TaskEvent as TaskEvent
    from construction_twin.work.task_states import TaskState as TaskState
    from construction_twin.work.worker import Worker as Worker
    from construction_twin.work.worker import WorkerError as WorkerError
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
