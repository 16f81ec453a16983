"""The change by which the scene says what hangs on the tool of an arm that was left engaged, before it goes back.

The scene after it has a hash that the engagement names, and only objects of the work are changed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from construction_twin.core.reports import EngagementReport
from construction_twin.core.sentences import Sentence
from construction_twin.robot.motion_errors import SceneError
from construction_twin.robot.segments import Segment
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange


def restoring_change(
    left: EngagementReport,
    scene: Scene,
    segments: Sequence[Segment],
    changes: Sequence[SceneChange],
    earlier: Iterable[Scene] = (),
    element: str = "",
    forms: Iterable[Sequence[SceneObject]] = (),
) -> SceneChange | str:
    """Return the change after which an engaged arm can go back, or why none is known.

    Args:
        segments, changes: Of the plan that ended inside; empty: unknown.
        forms: Objects of the element as the record can have them.
    """
    leading = [change for segment, change in zip(segments, changes) if segment.scene_after in left.scenes]
    mine = {name for change in changes for name in (*change.remove, *(item.name for item in change.put))}
    alternatives = [tuple(form) for form in forms]
    made = (_scene_of_hash(base, left.scenes, leading, element, alternatives) for base in (scene, *earlier))
    wanted = next((each for each in made if each is not None), None)
    if wanted is not None:
        found = _change_to(scene, wanted, mine)
        if isinstance(found, SceneChange):
            return found
        problem = found
    else:
        problem = Sentence(
            "no change of the work's objects makes the present scene {scene} the one in which it may go back ({scenes}): look at "
            "what hangs on the tool, undo what was changed in the scene since",
            scene=scene.hash[:12],
            scenes=" or ".join(each[:12] for each in left.scenes) or "none is known",
        )
        if not segments:
            problem = Sentence("plan {plan} is not known any more, and {problem}", plan=left.plan_id, problem=problem)
    where = f"the arm was left in engaged segment {left.segment!r} of plan {left.plan_id}"
    return Sentence(
        "{left}; {problem}, or free the arm by hand and call release_engagement", left=where, problem=problem
    )


def switches_confirmed(left: EngagementReport, segment: Segment) -> bool:
    """Return whether an engagement confirms the switches at a segment's end."""
    return segment.scene_after != segment.scene and set(left.scenes) == {segment.scene_after}


def _scene_of_hash(
    base: Scene,
    scenes: Sequence[str],
    changes: Sequence[SceneChange],
    element: str,
    forms: Sequence[tuple[SceneObject, ...]],
) -> Scene | None:
    """Return a scene of one of these hashes that a change makes of another scene; None: no change does."""
    if base.hash in scenes:
        return base
    if element:
        there = tuple(name for name in base.names if name.startswith(f"{element}/"))
        changes = [*changes, *(SceneChange(form, there) for form in forms)]
        # replaced one by one, other objects keep leave to touch them
        kept = [tuple(name for name in there if name not in {item.name for item in form}) for form in forms]
        changes += [SceneChange(form, gone) for form, gone in zip(forms, kept)]
    for change in changes:
        try:
            made = change.apply(base)
        except SceneError:
            continue  # it removes what is not there: it does not lead from this scene to any other
        if made.hash in scenes:
            return made
    return None


def _change_to(scene: Scene, wanted: Scene, mine: set[str]) -> SceneChange | str:
    """Return the change from the present scene to a wanted one, or what of it is not the work's to change."""
    there, then = ({item.name: item for item in one.objects} for one in (scene, wanted))
    put = [item for name, item in then.items() if name not in there or _differ(there[name], item)]
    remove = [name for name in there if name not in then]

    def foreign(name: str) -> bool:
        if name in mine or "/" in name:
            return False
        # whom it may touch follows from what is removed and put
        return not (name in there and name in then) or _differ(
            replace(there[name], touch=()), replace(then[name], touch=())
        )

    if added := [name for name in remove if foreign(name)]:
        return Sentence("{names} came into the scene since: take it out again", names=_names(added))
    if others := [item.name for item in put if foreign(item.name)]:
        return Sentence(
            "{names} was changed or taken out of the scene since: put it back as it was", names=_names(others)
        )
    change = SceneChange(tuple(put), tuple(remove))
    try:
        made = change.apply(scene).hash
    except SceneError as error:
        return str(error)
    if made == wanted.hash:
        return change
    if scene.padding != wanted.padding:
        return Sentence("the scene's padding was changed since: set it back to {padding:g} m", padding=wanted.padding)
    return Sentence("the scene cannot be restored by putting and removing objects: do it by hand")


def _differ(one: SceneObject, other: SceneObject) -> bool:
    return one.contents() != other.contents()


def _names(names: Sequence[str]) -> str:
    return " and ".join(repr(name) for name in names[:3]) + (" and others" if len(names) > 3 else "")
