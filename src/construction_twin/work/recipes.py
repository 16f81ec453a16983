"""How an element is handled: where it is gripped, which way it leaves the stock and arrives, how fast, what may touch.

Read from a YAML file, see config/work/recipes.yaml; the first recipe that fits an element is used. The property set
`PROPERTY_SET` of the element in the model overrides single keys. Metres, kilograms, seconds; degrees in names that end in ``_deg``.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.validation import configuration_error, wrong_value
from construction_twin.core.work_errors import TaskPlanningError
from construction_twin.robot.tool import Tool
from construction_twin.work.building import Value
from construction_twin.work.jobs import PlaceJob
from construction_twin.work.matching import Match

#: The model's own property set for this package.
PROPERTY_SET = "CTwin_RobotTask"

_Finite = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=-1e4, le=1e4)]
_Length = Annotated[float, pydantic.Field(allow_inf_nan=False, gt=0.0, le=10.0)]
_Small = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=0.0, le=10.0)]
_Scale = Annotated[float, pydantic.Field(gt=0.0, le=1.0)]
_Turn = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=-360.0, le=360.0)]
_Axis = Literal["up", "+x", "-x", "+y", "-y", "+z", "-z"]
_Face = Literal["up", "+x", "-x", "+y", "-y", "+z", "-z", "any"]


def _not_zero(asked: str | tuple[float, float, float]) -> str | tuple[float, float, float]:
    if not isinstance(asked, str) and not any(asked):
        raise ValueError("a direction is a vector that is not zero")
    return asked


#: A direction: an axis of the element, up, or a vector in the robot's base_link.
Direction = Annotated[_Axis | tuple[_Finite, _Finite, _Finite], pydantic.AfterValidator(_not_zero)]


class _Strict(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)


class Grips(_Strict):
    """Where an element may be gripped, the best first.

    Attributes:
        faces: ``up``: flat faces that look up in the stock; ``+x`` to ``-z``: along the element's own axes; ``any``: all, the
            largest first.
        along, across: Where the tool's centre point goes, from the middle of gravity along the face's longer and shorter side [m].
        yaws_deg: How the tool's x axis is turned from the face's longer side [deg].
        turns_deg: By how much the element may be turned about the face's normal between stock and place, in turns that map its
            shape onto itself [deg].
        min_cups: So many cups must lie on the face whole, besides those that the mass needs.
        margin: Distance of a cup's rim from the face's edge [m].
        lever: Largest distance of the centre of gravity, seen along the face's normal, from the hull of the cups that hold [m].
        touching: Shapes of the tool that touch the element.
        beside: Shapes of the tool that may come closer than the scene's padding to what lies beside the element in stock and at its
            place.
    """

    faces: Annotated[tuple[_Face, ...], pydantic.Field(min_length=1)] = ("up",)
    along: Annotated[tuple[_Finite, ...], pydantic.Field(min_length=1)] = (0.0,)
    across: Annotated[tuple[_Finite, ...], pydantic.Field(min_length=1)] = (0.0,)
    yaws_deg: Annotated[tuple[_Turn, ...], pydantic.Field(min_length=1)] = (0.0,)
    turns_deg: Annotated[tuple[_Turn, ...], pydantic.Field(min_length=1)] = (0.0,)
    min_cups: Annotated[int, pydantic.Field(ge=1, le=100)] = 1
    margin: _Small = 0.002
    lever: _Small = 0.05
    touching: Annotated[tuple[str, ...], pydantic.Field(min_length=1)]
    beside: tuple[str, ...] = ()


class Stock(_Strict):
    """How the element is fetched.

    Attributes:
        approach: Length of the straight way of the tool to the face, against its normal [m].
        leave: Which way the element leaves, the best first.
        lengths: Lengths of that straight way [m], tried one after the other.
    """

    approach: _Length = 0.1
    leave: Annotated[tuple[Direction, ...], pydantic.Field(min_length=1)] = ("up",)
    lengths: Annotated[tuple[_Length, ...], pydantic.Field(min_length=1)] = (0.1,)


class Place(_Strict):
    """How the element is set down.

    Attributes:
        arrive: From which side the element comes, the best first.
        lengths: Lengths of that straight way [m], tried one after the other.
        retreat: Length of the straight way of the tool from the face, along its normal [m].
        fastened: Something that the model does not show holds the element before the tool lets go: screws, glue, a clamp. Else an
            element that nothing is under is refused: it would fall.
    """

    arrive: Annotated[tuple[Direction, ...], pydantic.Field(min_length=1)] = ("up",)
    lengths: Annotated[tuple[_Length, ...], pydantic.Field(min_length=1)] = (0.1,)
    retreat: _Length = 0.1
    fastened: bool = False


class Recipe(_Strict):
    """How elements of one kind are handled. The keys of the file, each explained in config/work/recipes.yaml.

    Attributes:
        speed: Of the tool on the straight ways [m/s].
        free_speed_scale, carry_speed_scale: Fraction of the joints' limits on the free ways, without and with the element.
        carry_engaged: After a stop while the element is carried freely, only the way back may be planned.
        penetration: How deep bodies that may touch may be in each other, by rounding and by inexact pieces [m].
        mass: Taken for elements whose mass the model does not say [kg]; None: they are refused.
    """

    match: Match = Match()
    grips: Grips
    stock: Stock = Stock()
    place: Place = Place()
    speed: Annotated[float, pydantic.Field(gt=0.0, le=2.0)]
    free_speed_scale: _Scale
    carry_speed_scale: _Scale
    carry_engaged: bool = False
    penetration: Annotated[float, pydantic.Field(ge=0.0, le=0.02)] = 0.0005
    mass: Annotated[float, pydantic.Field(gt=0.0, le=1e4)] | None = None


class _File(_Strict):
    recipes: Annotated[dict[str, Recipe], pydantic.Field(min_length=1)]


def _same(value: Value) -> Value:
    return value


def _words(value: Value) -> tuple[str, ...]:
    return tuple(str(value).split())


def _numbers(value: Value) -> tuple[float, ...] | tuple[str, ...]:
    words = str(value).split()
    try:
        return tuple(map(float, words))
    except ValueError:
        return tuple(words)


@dataclass(frozen=True)
class Override:
    """One property of `PROPERTY_SET`.

    Attributes:
        key: The key of the recipe that it replaces.
        ifc_type: Type of its value.
        meaning: For documents.
        read: From the property's value to the key's.
    """

    key: tuple[str, ...]
    ifc_type: str
    meaning: str
    read: Callable[[Value], Any]


#: The properties by name. Lengths are plain IfcReal in metres whatever the file's unit is. ``Recipe`` chooses a recipe by its name,
#: ``Delivered`` is read by racks of the kind `delivered`.
OVERRIDES: Mapping[str, Override] = {
    "Faces": Override(("grips", "faces"), "IfcLabel", "faces to grip, the best first: `up +x any`", _words),
    "Along": Override(
        ("grips", "along"), "IfcLabel", "offsets along the face's longer side [m]: `0 0.1 -0.1`", _numbers
    ),
    "Across": Override(("grips", "across"), "IfcLabel", "offsets along the shorter side [m]", _numbers),
    "Yaws_deg": Override(
        ("grips", "yaws_deg"), "IfcLabel", "turns of the tool from the longer side [deg]: `0 90`", _numbers
    ),
    "Turns_deg": Override(("grips", "turns_deg"), "IfcLabel", "turns of a symmetric element [deg]: `0 180`", _numbers),
    "MinCups": Override(("grips", "min_cups"), "IfcInteger", "cups that must hold", _same),
    "Beside": Override(
        ("grips", "beside"), "IfcLabel", "shapes of the tool that may be close to neighbours: `cups`", _words
    ),
    "Approach": Override(("stock", "approach"), "IfcReal", "straight way of the tool to the element [m]", _same),
    "Leave": Override(("stock", "leave"), "IfcLabel", "which way it leaves the stock: `up +x`", _words),
    "LeaveLengths": Override(("stock", "lengths"), "IfcLabel", "lengths of that way [m]: `0.1 0.2`", _numbers),
    "Arrive": Override(("place", "arrive"), "IfcLabel", "from which side it is set down: `up -y`", _words),
    "ArriveLengths": Override(("place", "lengths"), "IfcLabel", "lengths of that way [m]", _numbers),
    "Retreat": Override(("place", "retreat"), "IfcReal", "straight way of the tool from the element [m]", _same),
    "Fastened": Override(
        ("place", "fastened"), "IfcBoolean", "something not in the model holds it before the tool lets go", _same
    ),
    "Speed": Override(("speed",), "IfcReal", "of the tool on the straight ways [m/s]", _same),
    "CarrySpeedScale": Override(
        ("carry_speed_scale",), "IfcReal", "fraction of the joints' limits while it is carried", _same
    ),
    "CarryEngaged": Override(
        ("carry_engaged",), "IfcBoolean", "only the way back after a stop while it is carried", _same
    ),
    "Mass": Override(("mass",), "IfcReal", "mass of the element [kg], before every other source", _same),
}
_TYPES: Mapping[str, tuple[type, ...]] = {
    "IfcLabel": (str,),
    "IfcInteger": (int,),
    "IfcReal": (int, float),
    "IfcBoolean": (bool,),
}
#: Names that are no keys of a recipe.
RECIPE, DELIVERED = "Recipe", "Delivered"


@dataclass(frozen=True)
class Chosen:
    """A recipe for one element.

    Attributes:
        recipe: With the model's own overrides.
        mass: Of the element [kg].
    """

    name: str
    recipe: Recipe
    mass: float


@dataclass(frozen=True)
class _Asked:
    """A job as `matching` asks."""

    id: str
    ifc_class: str
    name: str
    type_name: str
    properties: Mapping[str, Mapping[str, Value]]


@dataclass(frozen=True)
class Recipes:
    """The recipes of one file, in their order."""

    file: str
    recipes: Mapping[str, Recipe]

    def choose(self, job: PlaceJob, tool: Tool) -> Chosen:
        """Return the recipe for a job, with the overrides of the model, and the mass to plan with.

        Raises:
            TaskPlanningError: If no recipe fits, a property of `PROPERTY_SET` is wrong, the mass is not known, or too large for
                tool or load.
        """
        name, recipe = self.of(job)
        own = job.properties.get(PROPERTY_SET, {})
        mass = recipe.mass if "Mass" in own or job.mass is None else job.mass
        _check_mass(job, name, mass, tool)
        assert mass is not None
        return Chosen(name, recipe, mass)

    def of(self, job: PlaceJob) -> tuple[str, Recipe]:
        """Return the name of the recipe for a job, and it with the overrides of the model; raises as `choose`, masses apart."""
        asked = _Asked(job.element, job.ifc_class, job.element_name, job.type_name, job.properties)
        own = {name: value for name, value in job.properties.get(PROPERTY_SET, {}).items() if name != "id"}
        name = self._named(job, own) or self._first(job, asked)
        return name, self._overridden(job, self.recipes[name], own)

    def check_tool(self, tool: Tool) -> None:
        """Check that every recipe names shapes that the tool has.

        Raises ConfigurationError.
        """
        for name, recipe in self.recipes.items():
            for key, shapes in (("touching", recipe.grips.touching), ("beside", recipe.grips.beside)):
                for shape in shapes:
                    if shape not in tool.shapes:
                        known = ", ".join(tool.shapes)
                        raise ConfigurationError(
                            f"{self.file}/recipes/{name}/grips/{key}", shape, f"one of the tool's shapes: {known}"
                        )

    def _named(self, job: PlaceJob, own: Mapping[str, Value]) -> str:
        name = own.get(RECIPE)
        if name is None:
            return ""
        if name not in self.recipes:
            raise _wrong(job, RECIPE, name, f"one of {', '.join(self.recipes)} in {self.file}")
        return str(name)

    def _first(self, job: PlaceJob, asked: _Asked) -> str:
        for name, recipe in self.recipes.items():
            if recipe.match.fits(asked):
                return name
        kind = f"{job.ifc_class} {job.type_name!r}" if job.type_name else job.ifc_class
        raise TaskPlanningError(
            job.task, f"no recipe of {self.file} fits {_element(job)}, {kind}; add one, or name one in {PROPERTY_SET}"
        )

    def _overridden(self, job: PlaceJob, recipe: Recipe, own: Mapping[str, Value]) -> Recipe:
        for name, value in own.items():
            if name in (RECIPE, DELIVERED) or value is None:
                continue
            if name not in OVERRIDES:
                near = difflib.get_close_matches(name, [*OVERRIDES, RECIPE, DELIVERED], n=1)
                known = f"no such property; did you mean {near[0]}?" if near else "no such property"
                raise _wrong(job, name, value, known)
            override = OVERRIDES[name]
            if isinstance(value, bool) != (override.ifc_type == "IfcBoolean") or not isinstance(
                value, _TYPES[override.ifc_type]
            ):
                raise _wrong(job, name, value, override.ifc_type)
            document = recipe.model_dump()
            inner = document
            for key in override.key[:-1]:
                inner = inner[key]
            inner[override.key[-1]] = override.read(value)
            try:
                recipe = Recipe.model_validate(document)
            except pydantic.ValidationError as error:
                wrong = wrong_value(error, Recipe.model_json_schema())
                raise _wrong(job, name, value, f"{wrong.expected} ({override.ifc_type})") from error
        return recipe


def read_recipes(path: str | Path) -> Recipes:
    """Read a recipes file.

    Raises:
        ConfigurationError: Naming file, key, value and what was expected.
    """
    try:
        description = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigurationError(
            str(path), " ".join(str(error).split()), "a YAML file of recipes, as config/work/recipes.yaml"
        ) from error
    try:
        return Recipes(str(path), _File.model_validate(description).recipes)
    except pydantic.ValidationError as error:
        raise configuration_error(error, _File, str(path)) from error


def _check_mass(job: PlaceJob, recipe: str, mass: float | None, tool: Tool) -> None:
    if mass is None:
        raise TaskPlanningError(
            job.task,
            f"the mass of {_element(job)} is not known: give it a weight or a density in the model, {PROPERTY_SET}.Mass, or "
            f"recipe {recipe!r} a mass",
        )
    if not mass > 0.0:
        raise TaskPlanningError(job.task, f"{_element(job)} has a mass of {mass:g} kg; expected above 0")
    if mass > tool.payload:
        raise TaskPlanningError(
            job.task, f"{_element(job)} has {mass:.1f} kg; tool {tool.name!r} carries at most {tool.payload:g} kg"
        )
    if tool.mass + mass > tool.load:
        raise TaskPlanningError(
            job.task,
            f"{_element(job)} and tool {tool.name!r} together have {tool.mass + mass:.1f} kg; the controller's load data are for "
            f"{tool.load:g} kg",
        )


def _element(job: PlaceJob) -> str:
    return f"element {job.element_name!r} ({job.element})" if job.element_name else f"element {job.element}"


def _wrong(job: PlaceJob, name: str, value: object, expected: str) -> TaskPlanningError:
    return TaskPlanningError(job.task, f"{_element(job)}, {PROPERTY_SET}.{name}: found {value!r}, expected {expected}")
