"""The recipe of `place` (keys: config/work/recipes.yaml), and where its suction cups can hold an element, in the element's frame.

Metres, kilograms, seconds; degrees in ``_deg``. A cup lies on a face when its rim and a margin do: its middle, 16 points of the rim
and 8 half way have material just inside and none just outside. A hole between these points is not seen. Cups beside the face close
by themselves.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import pydantic
import shapely
from scipy.spatial import ConvexHull, QhullError

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.work.element_bodies import ElementPieces
from construction_twin.extensions.work.process import Finite, Length, Recipe, Scale, TaskPlanningError, WorkJob
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.tool import Cups, Tool
from construction_twin.validation import StrictModel

_Small = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=0.0, le=10.0)]
_Turn = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=-360.0, le=360.0)]
_Axis = Literal["up", "+x", "-x", "+y", "-y", "+z", "-z"]
_Face = Literal["up", "+x", "-x", "+y", "-y", "+z", "-z", "any"]


def _not_zero(asked: str | tuple[float, float, float]) -> str | tuple[float, float, float]:
    if not isinstance(asked, str) and not any(asked):
        raise ValueError("a vector that is not zero")
    return asked


#: A direction: an axis of the element, up, or a vector in the robot's base_link.
Direction = Annotated[_Axis | tuple[Finite, Finite, Finite], pydantic.AfterValidator(_not_zero)]


class Grips(StrictModel):
    """Where an element may be gripped; lengths in m."""

    faces: Annotated[tuple[_Face, ...], pydantic.Field(min_length=1)] = ("up",)
    along: Annotated[tuple[Finite, ...], pydantic.Field(min_length=1)] = (0.0,)
    across: Annotated[tuple[Finite, ...], pydantic.Field(min_length=1)] = (0.0,)
    yaws_deg: Annotated[tuple[_Turn, ...], pydantic.Field(min_length=1)] = (0.0,)
    turns_deg: Annotated[tuple[_Turn, ...], pydantic.Field(min_length=1)] = (0.0,)
    min_cups: Annotated[int, pydantic.Field(ge=1, le=100)] = 1
    margin: _Small = 0.002
    lever: _Small = 0.05
    touching: Annotated[tuple[str, ...], pydantic.Field(min_length=1)]
    beside: tuple[str, ...] = ()


class Stock(StrictModel):
    """How the element is fetched; lengths in m."""

    approach: Length = 0.1
    leave: Annotated[tuple[Direction, ...], pydantic.Field(min_length=1)] = ("up",)
    lengths: Annotated[tuple[Length, ...], pydantic.Field(min_length=1)] = (0.1,)


class Place(StrictModel):
    """How the element is set down; lengths in m."""

    arrive: Annotated[tuple[Direction, ...], pydantic.Field(min_length=1)] = ("up",)
    lengths: Annotated[tuple[Length, ...], pydantic.Field(min_length=1)] = (0.1,)
    retreat: Length = 0.1
    fastened: bool = False


class PlaceRecipe(Recipe):
    """How elements of one kind are placed; `mass`: of elements without one in the model [kg], None: refused."""

    grips: Grips
    stock: Stock = Stock()
    place: Place = Place()
    carry_speed_scale: Scale
    carry_engaged: bool = False
    mass: Annotated[float, pydantic.Field(gt=0.0, le=1e4)] | None = None


def mass_of(job: WorkJob, name: str, recipe: PlaceRecipe, tool: Tool) -> float:
    """Return the mass that an element is placed with [kg]."""
    mass = recipe.mass if job.element.mass is None else job.element.mass
    if mass is None:
        said = f"give it a weight or a density in the model, or recipe {name!r} a mass"
        raise TaskPlanningError(job.task, f"the mass of {job.label} is not known: {said}")
    if not mass > 0.0:
        raise TaskPlanningError(job.task, f"{job.label} has a mass of {mass:g} kg; expected above 0")
    if mass > tool.payload:
        most = f"tool {tool.name!r} carries at most {tool.payload:g} kg"
        raise TaskPlanningError(job.task, f"{job.label} has {mass:.1f} kg; {most}")
    if tool.mass + mass > tool.load:
        both = f"{job.label} and tool {tool.name!r} together have {tool.mass + mass:.1f} kg"
        raise TaskPlanningError(job.task, f"{both}; the controller's load data are for {tool.load:g} kg")
    return mass


def check_tool(recipe: PlaceRecipe, tool: Tool, where: str) -> None:
    """Check that a recipe names shapes that the tool has."""
    for key, shapes in (("touching", recipe.grips.touching), ("beside", recipe.grips.beside)):
        for shape in shapes:
            if shape not in tool.shapes:
                known = ", ".join(tool.shapes)
                raise ConfigurationError(f"{where}/grips/{key}", shape, f"one of the tool's shapes: {known}")


#: How far inside and outside of a face is looked for material [m].
_SKIN = 5e-4
#: A face looks up if its normal is within this angle of it [rad].
_UP = math.radians(30.0)
#: A face lies along an axis if its normal is within this angle of it [rad].
_ALONG = math.radians(5.0)
AXES = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}


@dataclass(frozen=True, eq=False)
class Grip:
    """One way to hold an element.

    Attributes:
        element_T_tcp: In its stock; z into the face.
        element_T_turned: The frame that takes the place of its own, of an element that is the same body when it is turned.
    """

    name: str
    element_T_tcp: Pose
    element_T_turned: Pose
    cups: int


@dataclass(frozen=True, eq=False)
class GripSearch:
    """The grips, or why the candidate that came furthest was left out."""

    grips: tuple[Grip, ...]
    reason: str


def find_grips(pieces: ElementPieces, up: np.ndarray, mass: float, recipe: PlaceRecipe, tool: Tool) -> GripSearch:
    """Return the grips of an element by faces, its turns, the tool's turns, then places; `up`: in the stock."""
    wanted = recipe.grips
    if tool.cups is None:
        return GripSearch((), f"tool {tool.name!r} has no cups")
    needed = max(wanted.min_cups, math.ceil(mass / tool.cups.holds - 1e-9))
    if needed > len(tool.cups.at):
        return GripSearch((), f"{mass:.1f} kg need {needed} cups; tool {tool.name!r} has {len(tool.cups.at)}")
    if not pieces.solid:
        return GripSearch((), "its body is not closed (or not convex): no grip is known")
    faces = _faces(pieces, up, wanted.faces)
    if not faces:
        return GripSearch((), f"it has no flat face {' or '.join(wanted.faces)}")
    grips: list[Grip] = []
    reasons: list[tuple[int, str]] = []
    for name, frame in faces:
        turned = [(turn, _turned(frame, turn)) for turn in wanted.turns_deg]
        places = itertools.product(wanted.yaws_deg, wanted.along, wanted.across)
        tools = [(place, _tool_at(frame, *place)) for place in places]
        held = [(place, tcp, _cups_on_face(tcp, pieces, tool.cups, wanted.margin)) for place, tcp in tools]
        for turn, element_T_turned in turned:
            if turn % 360.0 and not pieces.same_turned(element_T_turned):
                continue
            for (yaw, along, across), tcp, cups in held:
                where = f"{name} {1e3 * along:g} mm along, {1e3 * across:g} mm across, tool at {yaw:g} deg"
                problem = _obstacle(where, tcp, cups, needed, wanted.lever, pieces)
                if problem:
                    reasons.append(problem)
                    continue
                where += f", element turned {turn:g} deg" if turn else ""
                grips.append(Grip(f"{where}, {len(cups)} cups", tcp, element_T_turned, len(cups)))
    return GripSearch(tuple(grips), max(reasons, default=(0, "its shape does not allow the turns"))[1])


def _turned(frame: Pose, angle_deg: float) -> Pose:
    about = frame.rotation @ _about_z(math.radians(angle_deg)) @ frame.rotation.T
    return Pose(frame.position - about @ frame.position, about)


def _tool_at(frame: Pose, yaw_deg: float, along: float, across: float) -> Pose:
    into = frame.rotation @ _about_z(math.radians(yaw_deg)) @ np.diag([1.0, -1.0, -1.0])
    return Pose(frame.position + frame.rotation @ np.array([along, across, 0.0]), into)


def _cups_on_face(element_T_tcp: Pose, pieces: ElementPieces, cups: Cups, margin: float) -> np.ndarray:
    rotation = element_T_tcp.rotation
    middles = np.array([element_T_tcp.position + rotation @ (x, y, 0.0) for x, y in cups.at])
    points = (middles[:, None] + _disc(cups.radius + margin) @ rotation.T).reshape(-1, 3)
    out = -rotation[:, 2] * _SKIN
    lies = pieces.contain(points - out) & ~pieces.contain(points + out)
    return middles[lies.reshape(len(middles), -1).all(axis=1)]


def _faces(pieces: ElementPieces, up: np.ndarray, wanted: tuple[str, ...]) -> list[tuple[str, Pose]]:
    """Return names and frames of the wanted faces: below the centre of gravity, x along the longer side, z outwards."""
    found: dict[int, tuple[str, Pose]] = {}
    for word in wanted:
        for number, plane in enumerate(pieces.planes):
            if number not in found and _faces_towards(plane[:3], word, up):
                name = _axis_name(plane[:3]) if word in ("any", "up") else word
                found[number] = name, _frame(pieces, plane)
    return list(found.values())


def _faces_towards(normal: np.ndarray, word: str, up: np.ndarray) -> bool:
    if word == "any":
        return True
    if word == "up":
        return float(normal @ up) >= math.cos(_UP)
    return float(normal @ AXES[word]) >= math.cos(_ALONG)


def _axis_name(normal: np.ndarray) -> str:
    for name, axis in AXES.items():
        if float(normal @ axis) >= math.cos(_ALONG):
            return name
    return "face " + " ".join(f"{value:.2f}" for value in normal)


def _frame(pieces: ElementPieces, plane: np.ndarray) -> Pose:
    normal = plane[:3]
    points = pieces.on(plane)
    # the longer side of the smallest rectangle around the face that has a side in common with an edge of its outline
    start = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = np.cross(normal, start)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    flat = np.column_stack([points @ first, points @ second])
    angle = _long_side(flat)
    x = math.cos(angle) * first + math.sin(angle) * second
    # of the two directions of a side, the one along the element's axes
    x = x if x[int(np.argmax(np.round(np.abs(x), 6)))] > 0 else -x
    position = pieces.centre - (pieces.centre @ normal + plane[3]) * normal
    return Pose(position, np.column_stack([x, np.cross(normal, x), normal]))


def _long_side(flat: np.ndarray) -> float:
    """Return the direction of the longer side of the smallest rectangle around points in a plane [rad]."""
    try:
        outline = flat[ConvexHull(flat).vertices]
    except QhullError:
        return 0.0
    best = (math.inf, 0.0)
    for step in np.roll(outline, -1, axis=0) - outline:
        angle = math.atan2(step[1], step[0])
        along = outline @ (math.cos(angle), math.sin(angle))
        across = outline @ (-math.sin(angle), math.cos(angle))
        area = round(float(np.ptp(along) * np.ptp(across)), 9)
        if area < best[0]:
            best = (area, angle if np.ptp(along) >= np.ptp(across) - 1e-9 else angle + 0.5 * math.pi)
    return best[1]


def _obstacle(
    where: str, tcp: Pose, cups: np.ndarray, needed: int, lever: float, pieces: ElementPieces
) -> tuple[int, str] | None:
    if len(cups) < needed:
        return len(cups), f"{where}: {len(cups)} cups lie on the face; {needed} are needed"
    flat, centre = ((points - tcp.position) @ tcp.rotation[:, :2] for points in (cups, pieces.centre))
    away = shapely.MultiPoint(flat).convex_hull.distance(shapely.Point(centre))
    if away > lever:
        beside = f"{where}: the centre of gravity is {1e3 * away:.0f} mm beside the cups that hold"
        return 1000, f"{beside}; at most {1e3 * lever:.0f} mm are allowed"
    return None


def _about_z(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    # exact for quarter turns, so that a turned element lies exactly where it did
    c, s = (round(value) if abs(value - round(value)) < 1e-12 else value for value in (c, s))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _disc(radius: float) -> np.ndarray:
    rim = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)
    angles, radii = np.concatenate([rim, rim[::2], [0.0]]), np.repeat([radius, 0.5 * radius, 0.0], [16, 8, 1])
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(len(angles))])
