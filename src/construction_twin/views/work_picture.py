"""What a reviewer sees of a work plan besides its tool path: what the arm carries in each segment, and what stands in the end.

Pure. The changes of the scene that are told with a plan are for displays; whether they lead to the scenes that an approval covers
can be said only where the scene before them is known, and is said then. Metres.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from construction_twin.core.motion_errors import SceneError
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.plan import Plan
from construction_twin.robot.segments import Segment
from construction_twin.scene.objects import Scene, SceneObject, product
from construction_twin.scene.scene_change import SceneChange

#: Ends of segments that are closer than this share one label [m].
SAME_MARK = 0.08
#: Most bodies that are drawn of each kind: a picture, not a scene.
MOST_BODIES = 200
#: Longest name of a segment, an object or a signal in a picture.
LONGEST_WORD = 28


@dataclass(frozen=True)
class WorkStates:
    """The objects that a work plan moves.

    Attributes:
        carried: Of each segment: what the arm carries during it, in the link that carries it; and, as one more, what it carries in
            the end.
        placed: What stands elsewhere in the end than before, or is new.
        problem: Why what is drawn may not be what is approved, as a sentence; empty: it is.
    """

    carried: tuple[tuple[SceneObject, ...], ...]
    placed: tuple[SceneObject, ...]
    problem: str = ""

    def loads(self, number: int) -> tuple[SceneObject, ...]:
        """Return what the arm carries in a segment, but not during all of the plan: the element, not the tool."""
        always = set.intersection(*({item.name for item in held} for held in self.carried))
        return tuple(item for item in self.carried[number] if item.name not in always)


def work_states(plan: Plan, changes: Sequence[SceneChange], scene: Scene | None) -> WorkStates:
    """Return what a work plan does to the objects.

    Args:
        changes: As told with its segments; fewer: not told.
        scene: The present scene. Unless it is the one that the plan begins in, only what the changes say is known.
    """
    known = scene is not None and scene.hash == plan.scene
    present = scene if scene is not None and known else Scene()
    before = {item.name: item for item in present.objects}
    told = [*changes, *[SceneChange()] * (len(plan.segments) - len(changes))]
    carried, problem = [], "" if known else "the scene that the plan begins in is not known here"
    for segment, change in zip(plan.segments, told):
        carried.append(tuple(item for item in present.objects if item.link))
        present = _after(present, change)
        if known and not problem and present.hash != segment.scene_after:
            problem = f"after {segment.name!r} the scene is to be another one than drawn here"
    carried.append(tuple(item for item in present.objects if item.link))
    placed = tuple(item for item in present.objects if not item.link and before.get(item.name) != item)
    return WorkStates(tuple(carried), placed, problem)


def _after(scene: Scene, change: SceneChange) -> Scene:
    gone = set(change.remove) & set(scene.names)
    try:
        return SceneChange(change.put, tuple(sorted(gone))).apply(scene)
    except SceneError:
        return scene


@dataclass(frozen=True, eq=False)
class WorkPath:
    """What is drawn of a work plan.

    Attributes:
        parts: Each of shape (m, 3). The tool's positions in each segment.
        engaged: Which of them are engaged.
        marks: Shape (3,). Where segments end, with their numbers and names.
        on_the_way: What is carried, where the arm carries it from one segment into the next.
    """

    parts: tuple[np.ndarray, ...]
    engaged: tuple[bool, ...]
    marks: tuple[tuple[str, np.ndarray], ...]
    on_the_way: tuple[tuple[SceneObject, Pose], ...]
    placed: tuple[SceneObject, ...]


def work_path(
    plan: Plan, states: WorkStates, forward: Callable[[np.ndarray], Pose], tip: str, spacing: float, most: int
) -> WorkPath:
    """Return what is drawn of a work plan.

    Args:
        forward: Returns the tip's pose in the base, for joint values of shape (n,).
        tip: Name of the tip link: what other links carry is not drawn on the way.
        spacing, most: Of the points of a path [s], and their number at most.
    """
    trajectory = plan.trajectory
    ends = [segment.end for segment in plan.segments]
    spacing = max(spacing, trajectory.duration / most)
    parts, poses = [], []
    for begin, end in zip([0.0, *ends[:-1]], ends):
        times = np.linspace(begin, end, max(2, round((end - begin) / spacing) + 1))
        tips = [forward(q) for q in trajectory.sample_many(times)[0]]
        parts.append(np.array([pose.position for pose in tips]))
        poses.append(tips[-1])
    on_the_way = [
        (item, product(pose, item.pose))
        for number, pose in enumerate(poses[:-1])
        for item in states.loads(number)
        if item.link == tip and item in states.loads(number + 1)
    ]
    return WorkPath(
        tuple(parts),
        tuple(segment.engaged for segment in plan.segments),
        _marks(plan.segments, [pose.position for pose in poses]),
        tuple(on_the_way[:MOST_BODIES]),
        states.placed[:MOST_BODIES],
    )


def _marks(segments: Sequence[Segment], points: Sequence[np.ndarray]) -> tuple[tuple[str, np.ndarray], ...]:
    """Return one label for each place where segments end."""
    marks: list[tuple[list[int], np.ndarray]] = []
    for number, point in enumerate(points):
        near = next((numbers for numbers, place in marks if np.linalg.norm(place - point) < SAME_MARK), None)
        if near is None:
            marks.append(([number], point))
        else:
            near.append(number)
    return tuple(
        (", ".join(f"{number + 1} {cut(segments[number].name)}" for number in numbers), point)
        for numbers, point in marks
    )


def segment_words(segment: Segment, change: SceneChange | None = None) -> list[str]:
    """Return what is special about a segment: engaged, what it needs, what is switched at its end, what becomes of the scene."""
    words: list[str] = ["engaged"] if segment.engaged else []
    if segment.requires:
        signals = ", ".join(_state(signal.name, signal.value) for signal in segment.requires)
        words.append(f"needs {signals}")
    if segment.switches:
        outputs = ", ".join(_state(switch.output, switch.value) for switch in segment.switches)
        words.append(f"then {outputs}")
    if segment.scene_after != segment.scene:
        words.append(change_words(change) if change else "the scene changes")
    return words


def change_words(change: SceneChange) -> str:
    """Return what becomes of the scene, by the names of whole things: an element's bodies are called ``<element>/0``, ..."""
    said: list[str] = []
    for verb, names in (
        ("carries", [item.name for item in change.put if item.link]),
        ("puts", [item.name for item in change.put if not item.link]),
        ("removes", [name for name in change.remove if name not in {item.name for item in change.put}]),
    ):
        things = list(dict.fromkeys(name.rsplit("/", 1)[0] for name in names))
        if things and verb == "removes":
            # what is gone is no longer kept clear of: the reviewer sees all of it
            said.append(f"removes {', '.join(things)}")
        elif things:
            first = cut(things[0])
            more = f"{first} and {len(things) - 1} more" if len(things) > 1 else first
            said.append(f"{verb} {more}")
    return ", ".join(said) or "the scene changes"


def cut(name: str) -> str:
    """Return a name as long as a picture can show it."""
    return name if len(name) <= LONGEST_WORD else name[: LONGEST_WORD - 3] + "..."


def _state(name: str, value: bool) -> str:
    return f"{cut(name)} on" if value else f"{cut(name)} off"
