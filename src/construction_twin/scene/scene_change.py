"""Several changes of a scene as one, without the scenes in between. Metres."""

from __future__ import annotations

from dataclasses import dataclass, replace

from construction_twin.robot.motion_errors import SceneError
from construction_twin.scene.objects import Scene, SceneObject, names_text


@dataclass(frozen=True)
class SceneChange:
    """What goes, by name, and what comes then, link and touch included.

    In `put` an object of a present name takes its place, fixed if that was; of a name in `remove` it is another one, which nothing
    may touch yet.
    """

    put: tuple[SceneObject, ...] = ()
    remove: tuple[str, ...] = ()

    def __post_init__(self):
        object.__setattr__(self, "put", tuple(self.put))
        object.__setattr__(self, "remove", tuple(self.remove))
        for key, names in (("put", [item.name for item in self.put]), ("remove", self.remove)):
            if len(set(names)) < len(names):
                raise SceneError(f"a name in {key}", next(x for x in names if names.count(x) > 1), "each name once")

    @property
    def carries(self) -> bool:
        """Whether a link carries something of what comes."""
        return any(item.link for item in self.put)

    def apply(self, scene: Scene) -> Scene:
        """Return the scene after the change; names in `touch` and `link` are checked where the scene meets a robot."""
        unknown = set(self.remove) - set(scene.names)
        if unknown:
            known = f"one of the scene's {names_text(scene.names)}; nothing was changed"
            raise SceneError("an object to remove", min(unknown), known)
        objects = {item.name: item for item in scene.without(self.remove).objects}
        for item in self.put:
            present = objects.get(item.name)
            objects[item.name] = item if present is None else replace(item, fixed=present.fixed)
        return replace(scene, objects=tuple(objects.values()))

    def apply_checked(self, scene: Scene, before: str = "", after: str = "") -> Scene:
        """Return the scene after the change, if it leads from one expected scene (hash; empty: any) to another."""
        if before and scene.hash != before:
            expected = f"{before}, that this change was made for; plan it anew from this one"
            raise SceneError("the scene to change", scene.hash, expected)
        changed = self.apply(scene)
        if after and changed.hash != after:
            expected = f"{after}; a mesh file may have changed. Nothing was changed"
            raise SceneError("the scene after the change", changed.hash, expected)
        return changed

    def __str__(self) -> str:
        changes = [
            f"{verb} {names[0]!r}" + (f" and {len(names) - 1} more" if len(names) > 1 else "")
            for verb, names in (("removed", self.remove), ("put", tuple(item.name for item in self.put)))
            if names
        ]
        return ", ".join(changes) or "changed nothing"
