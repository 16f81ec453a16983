"""The scene of a cell at one state of the work, and the job of each element: from cell, building model and convex pieces.

Metres; poses in the robot's base_link. Elements that are not delivered are not there, stock is where its rack says, what was placed
stands as built, and what no task makes or moves stands where the model has it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import TaskPlanningError
from construction_twin.kinematics.chain import Pose
from construction_twin.scene.objects import Scene, SceneObject, product
from construction_twin.work.building import BuildingModel
from construction_twin.work.contacts import Shapes, tool_objects
from construction_twin.work.convex_bodies import Pieces
from construction_twin.work.jobs import WorkJob
from construction_twin.work.racks import Slot, StockPlan, plan_stock
from construction_twin.work.schedule import Job
from construction_twin.work.site import Site, inverse
from construction_twin.work.wholes import comes_after

#: Elements at a pose whose objects are kept.
_STOOD = 5000


@dataclass(frozen=True, eq=False)
class WorkState:
    """What has been done.

    Attributes:
        placed: ``base_T_element`` of the elements that stand, as built.
        gone: Elements that are neither in stock nor placed: lost, in the grip, or taken down.
    """

    placed: Mapping[str, Pose] = field(default_factory=dict)
    gone: frozenset[str] = frozenset()


class Layout:
    """Where every element of a work is before and after.

    Args:
        pieces: Convex pieces of each element in `order`, in its own frame, called ``<GlobalId>/<number>``.
        standing: Pieces, as above, of the elements that stand where the model has them and that no task makes, see `work.standing`.
        jobs: Who works on them; by default one for each, called as the element, by the process of the element's own recipe.

    Attributes:
        standing: What stands from the beginning, fixed, in the robot's base_link.
        stays: The elements in `order` that no job moves: they stand at their place all the time.
        comes_after: Elements that are placed before what stands is there, by its GlobalId, see `wholes.comes_after`.
    """

    def __init__(
        self,
        site: Site,
        building: BuildingModel,
        pieces: Mapping[str, Sequence[SceneObject]],
        order: Sequence[str],
        link: str,
        standing: Mapping[str, Sequence[SceneObject]] = MappingProxyType({}),
        jobs: Sequence[Job] = (),
    ):
        self.site, self.building, self.order = site, building, tuple(order)
        self._pieces = {element: tuple(pieces[element]) for element in order}
        self._base_T_model = inverse(site.model_T_base(building))
        self._tool = tool_objects(site.tool, link)
        corners = {element: Pieces(items).points for element, items in self._pieces.items() if items}
        for element in order:
            if element not in corners:
                name = building.element(element).name
                raise TaskPlanningError(
                    element, Sentence("element {element} has no geometry; leave it out of the work", element=repr(name))
                )
        own = (Job(one, "", "", one, (), (), site.recipes.process(building.element(one))) for one in order)
        self._jobs = {job.id: job for job in jobs or own}
        placed = {job.element for job in self._jobs.values() if job.moves}
        self.stays = tuple(element for element in order if element not in placed)
        moved = [element for element in order if element in placed]
        self.stock: StockPlan = plan_stock(site, building, moved, corners)
        self.standing = tuple(
            replace(item.moved(product(self.base_T_goal(element), item.pose)), fixed=True)
            for element, items in standing.items()
            for item in items
        )
        self.comes_after = comes_after(building.elements, moved)
        self._shapes = Shapes()
        self._stood: dict[tuple[str, bytes], tuple[SceneObject, ...]] = {}

    def pieces(self, element: str) -> tuple[SceneObject, ...]:
        """Return an element's convex pieces, in its own frame."""
        return self._pieces[element]

    def slot(self, element: str) -> Slot | None:
        """Return where an element lies in stock; None: it stays where it stands."""
        return self.stock.slots.get(element)

    def base_T_goal(self, element: str) -> Pose:
        """Return where an element is to stand, as designed."""
        return product(self._base_T_model, self.building.element(element).model_T_element)

    def delivered(self, state: WorkState) -> tuple[str, ...]:
        """Return the elements that lie in stock."""
        return self.stock.present({*state.placed, *state.gone})

    def scene(self, state: WorkState = WorkState()) -> Scene:
        """Return the scene at a state: surroundings, the tool on the arm, what is in stock, what stands."""
        surroundings = self.site.scene
        standing = [item for item in self.standing if self._is_there(item.name.split("/", 1)[0], state)]
        objects = [*surroundings.objects, *standing, *self._tool]
        for element in self.delivered(state):
            objects += self._standing(element, self.stock.slots[element].base_T_element)
        for element in self.stays:
            if element not in state.placed and element not in state.gone:
                objects += self._standing(element, self.base_T_goal(element))
        for element, pose in state.placed.items():
            if element in self._pieces:
                objects += self._standing(element, pose)
        return Scene(tuple(objects), surroundings.padding)

    def _is_there(self, standing: str, state: WorkState) -> bool:
        return standing not in state.gone and state.placed.keys() >= self.comes_after.get(standing, frozenset())

    def job_for(self, element: str, scene: Scene, task: str = "") -> WorkJob:
        """Return the job of an element.

        Args:
            task: Id of the job; empty, or one that the layout does not know: its first one.
        """
        asked = self._jobs.get(task) or next(job for job in self._jobs.values() if job.element == element)
        built, slot = self.building.element(element), self.slot(element) if asked.moves else None
        goal = self.base_T_goal(element) if asked.moves else self._stands(element, scene)
        of_task = self.building.tasks.get(asked.task)
        of_work = {item.name for items in self._pieces.values() for item in items}
        of_work |= {item.name for item in self.standing}
        own = {item.name for item in self._pieces[element]}
        others = [item for item in scene.objects if item.name in of_work - own and not item.link]
        beside = {
            name
            for pose in ([goal] if slot is None else [slot.base_T_element, goal])
            for name in self._shapes.near(self._pieces[element], [pose], others, scene.padding)
        }
        x, y, z = map(float, self._base_T_model.rotation[:, 2])
        fixed = {*self.site.file.supports, *([] if slot is None else [slot.surface])} & set(scene.names)
        return WorkJob(
            task or element,
            built,
            bodies=self._pieces[element],
            base_T_stock=None if slot is None else slot.base_T_element,
            base_T_goal=goal,
            supports=tuple(sorted(beside | fixed)),
            up=(x, y, z),
            task_properties={} if of_task is None else of_task.properties,
        )

    def _stands(self, element: str, scene: Scene) -> Pose:
        """Return where an element stands in a scene; as designed where it does not."""
        first = self._pieces[element][0]
        if first.name not in scene.names or scene.get(first.name).link:
            return self.base_T_goal(element)
        return product(scene.get(first.name).pose, inverse(first.pose))

    def _standing(self, element: str, base_T_element: Pose) -> tuple[SceneObject, ...]:
        """Return an element's pieces at a pose; they are kept, because most elements stay where they are."""
        key = element, base_T_element.position.tobytes() + base_T_element.rotation.tobytes()
        if key not in self._stood:
            if len(self._stood) >= _STOOD:
                self._stood.clear()
            self._stood[key] = tuple(item.moved(product(base_T_element, item.pose)) for item in self._pieces[element])
        return self._stood[key]
