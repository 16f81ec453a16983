"""The building model in rviz: every element at its place in a colour that says how far it is, and the name of the next one.

Pure; metres. Drawn are the triangles of the model, not the convex pieces that are checked.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from construction_twin.core.sentences import Sentence
from construction_twin.kinematics.chain import Pose

#: Colours r, g, b, a of the words for an element's state. What is not there yet is seen through.
COLOURS = {
    "todo": (0.60, 0.62, 0.66, 0.25),
    "next": (0.10, 0.40, 0.95, 0.55),
    "stock": (0.80, 0.62, 0.35, 1.00),
    "carried": (0.95, 0.60, 0.10, 1.00),
    "placed": (0.20, 0.65, 0.30, 1.00),
    "off": (0.85, 0.12, 0.10, 1.00),
    "skipped": (0.35, 0.30, 0.40, 0.12),
}
#: So far the colour stands out of the element [m]: the scene draws its own body at the same place, and only one is seen there.
SKIN = 0.003
#: Height of the text, and its distance above the element [m].
TEXT_SIZE, TEXT_ROOM = 0.10, 0.15
#: Namespace of the text; no GlobalId has it.
TEXT = "work next"


@dataclass(frozen=True, eq=False)
class DrawnElement:
    """One element, drawn once: an element that lies in stock and is to be placed elsewhere is given twice, with two keys.

    Attributes:
        key: Names the marker: the GlobalId, or that with a word behind it.
        name: For a person.
        triangles: Shape (t, 3, 3). Corners in the element's frame [m]; see `work.element_bodies.element_triangles`.
        pose: Of the element in the base_link, or in `link`.
        state: One of `COLOURS`.
        link: Link that carries it; empty: it stands in the world.
    """

    key: str
    name: str
    triangles: np.ndarray
    pose: Pose
    state: str
    link: str = ""

    def __post_init__(self):
        if self.state not in COLOURS:
            raise ValueError(f"element {self.key}: state {self.state!r}, expected one of {list(COLOURS)}")


@dataclass(frozen=True, eq=False)
class WorkPicture:
    """What is drawn of a building model, and what no more.

    Attributes:
        text: Empty: nothing is next.
        text_at: Length 3. In the base_link.
        gone: Keys of markers to delete.
    """

    elements: tuple[DrawnElement, ...]
    text: str
    text_at: tuple[float, float, float]
    gone: tuple[str, ...]

    @property
    def keys(self) -> frozenset[str]:
        """Keys of all markers that are there after it; to be given as `shown` next time."""
        return frozenset([item.key for item in self.elements] + ([TEXT] if self.text else []))


def work_picture(elements: Iterable[DrawnElement], shown: Iterable[str] = ()) -> WorkPicture:
    """Return what is to be drawn.

    All of it each time: who begins to listen to a latched topic hears the last message only.

    Args:
        shown: `WorkPicture.keys` of the picture before.
    """
    drawn = tuple(item for item in elements if len(item.triangles))
    following = next((item for item in drawn if item.state == "next"), None)
    text, text_at = "", (0.0, 0.0, 0.0)
    if following is not None:
        corners = placed_triangles(following).reshape(-1, 3)
        x, y = 0.5 * (corners[:, :2].min(axis=0) + corners[:, :2].max(axis=0))
        text, text_at = (
            Sentence("view.next", element=following.name),
            (float(x), float(y), float(corners[:, 2].max()) + TEXT_ROOM),
        )
    picture = WorkPicture(drawn, text, text_at, ())
    return WorkPicture(drawn, text, text_at, tuple(sorted(set(shown) - picture.keys)))


def placed_triangles(item: DrawnElement) -> np.ndarray:
    """Return an element's triangles in the base_link, or in the link that carries it, shape (t, 3, 3) [m]."""
    return np.asarray(item.triangles) @ item.pose.rotation.T + item.pose.position
