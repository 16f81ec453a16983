"""Contacts that no motion of the arm ends: of its base, or of a link in every pose, with an object that stands. Lengths in m."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from construction_twin.scene.collision_world import CollisionWorld

#: A base that overlaps an object by less than this stands on it [m].
STANDS_ON = 1e-3
#: Random poses, besides home, in all of which a link must touch an object.
POSES = 100


@dataclass(frozen=True)
class LastingContact:
    """An object that stands in the world, and a link that touches it whatever the joints do.

    `distance` at home and `margin` of a moving link [m]; a base, which no joint `moves`, is not checked.
    """

    name: str
    link: str
    distance: float
    margin: float
    moves: bool

    @property
    def sentence(self) -> str:
        """What it is, what follows from it, and what to do."""
        if not self.moves:
            return (
                f"object {self.name!r} and link {self.link!r} overlap by {-self.distance * 1e3:.1f} mm; no "
                "joint moves the link, so this is not checked. If they do not overlap in the cell, correct "
                f"the object's position or size, or raise the arm; if they do, add `touch: [{self.link}]` to "
                "the object"
            )
        found = f"{'overlap' if self.distance < 0.0 else 'are apart'} by {abs(self.distance) * 1e3:.1f} mm"
        return (
            f"object {self.name!r} and link {self.link!r} {found}, expected {self.margin * 1e3:.1f} mm of clearance, in every pose "
            "of the arm: nothing can be planned. Move the object, raise the arm or lower `padding`; if they may touch, add "
            f"`touch: [{self.link}]` to the object"
        )


def lasting_contacts(world: CollisionWorld) -> list[LastingContact]:
    """Return the contacts of a world that no motion ends, those of the base first.

    A pair of which the object names the link in `touch` is meant, and not among them.
    """
    found = [
        LastingContact(item.name, link, distance, 0.0, False)
        for item, link in world.unchecked_pairs()
        if (distance := world.distance(world.robot.home, link, item.name)) < -STANDS_ON
    ]
    standing = {item.name: item for item in world.scene.objects if not item.link}
    names = set(world.scene.names)
    touching = (contact.between for contact in world.contacts(world.robot.home))
    pairs = [(first, second) for first, second in touching if first not in names and second in standing]
    poses = np.random.default_rng(0).uniform(world.robot.lower, world.robot.upper, (POSES, len(world.robot.home)))
    for q in poses:
        if not pairs:
            break
        still = {contact.between for contact in world.contacts(q)}
        pairs = [pair for pair in pairs if pair in still]
    for link, name in pairs:
        margin = world.scene.padding + standing[name].padding
        found.append(LastingContact(name, link, world.distance(world.robot.home, link, name), margin, True))
    return found
