"""Models that were read wrongly without a word: kinds and ends of tasks, lost lines and parts, units, places."""

from __future__ import annotations

import numpy as np
import pytest
from ifc_models import IfcModel, remarked, two_studs

from construction_twin.extensions.work.building import BuildingError
from construction_twin.extensions.work.schedule import Schedule

STUD = (0.1, 0.1, 1.0)


def jobs(found):
    """What is placed, by name."""
    return [found.elements[job.element].name for job in Schedule.of(found).jobs]


def removals(found):
    """What people take down, by name."""
    return [found.elements[job.element].name for job in Schedule.of(found).removals]


# -- kinds of tasks


def kind_of_the_whole(model, task):
    model.root("IfcRelNests", RelatingObject=model.task("old", PredefinedType="DEMOLITION"), RelatedObjects=[task])


def kind_of_the_aggregate(model, task):
    model.aggregate(model.task("old", PredefinedType="REMOVAL"), [task])


def kind_of_the_type(model, task):
    kind = model.root("IfcTaskType", Name="old", PredefinedType="DEMOLITION")
    model.root("IfcRelDefinesByType", RelatedObjects=[task], RelatingType=kind)


def kind_in_a_word(model, task):
    task.PredefinedType, task.ObjectType = "NOTDEFINED", "Removal"


@pytest.mark.parametrize("say", [kind_of_the_whole, kind_of_the_aggregate, kind_of_the_type, kind_in_a_word])
def test_what_is_taken_down_is_so_wherever_the_file_says_it(read, say):
    model, _, (first, _) = two_studs()
    say(model, first)
    found = read(model)
    assert (jobs(found), removals(found)) == (["b"], ["a"])
    assert remarked(found, first, "the arm takes nothing down")


def test_a_task_that_says_its_own_kind_has_it_within_another(read):
    model, _, (first, _) = two_studs()
    first.PredefinedType = "CONSTRUCTION"
    kind_of_the_whole(model, first)
    assert jobs(read(model)) == ["a", "b"]


@pytest.mark.parametrize(("word", "down"), [("DISPOSAL", ["a"]), ("Demolition", ["a"]), ("MAINTENANCE", [])])
def test_words_of_ifc2x3_are_kinds(read, word, down):
    model, _, (first, _) = two_studs("IFC2X3")
    first.ObjectType = word
    found = read(model)
    assert (jobs(found), removals(found)) == (["b"], down)


# -- what is done


def test_a_task_in_a_completed_one_that_says_otherwise_is_told_as_taken(read):
    model, _, tasks = two_studs()
    whole = model.task("floor", Status="COMPLETED")
    model.root("IfcRelNests", RelatingObject=whole, RelatedObjects=tasks)
    tasks[0].Status = "STARTED"
    found = read(model)
    assert jobs(found) == []
    assert remarked(found, tasks[0], "completed, or what they nest in is")
    assert not remarked(found, tasks[0], "taken as still to be done")


def test_a_new_part_of_what_exists_is_placed(read):
    model = IfcModel()
    panel = model.element("IfcElementAssembly", "panel")
    new, old = (model.box(name, STUD, at=(k, 0, 0), within=panel) for k, name in enumerate(("new", "old")))
    model.aggregate(panel, [new, old])
    model.properties(panel, "Pset_ElementAssemblyCommon", Status="EXISTING")
    model.properties(new, "Pset_MemberCommon", Status="NEW")
    model.task("place", [new])
    found = read(model)
    assert [found.elements[one.GlobalId].status for one in (panel, new, old)] == ["existing", "", "existing"]
    assert jobs(found) == ["new"]


def test_an_assembly_within_another_has_a_task_of_its_own(read):
    model = IfcModel()
    outer = model.element("IfcElementAssembly", "outer")
    inner = model.element("IfcElementAssembly", "inner", within=outer)
    own, part = model.box("own", STUD, within=outer), model.box("part", STUD, at=(1, 0, 0), within=inner)
    model.aggregate(outer, [inner, own])
    model.aggregate(inner, [part])
    model.task("outer up", [outer])
    task = model.task("inner up", [inner])
    assert jobs(read(model)) == ["own", "part"]
    task.Status = "COMPLETED"
    assert jobs(read(model)) == ["own"]


# -- what the parser and the kernel lose


def renamed(model, entity) -> str:
    """The text of a model in which the schema does not know an entity's kind."""
    line = f"#{entity.id()}={entity.is_a().upper()}"
    assert f"{line}(" in model.text()
    return model.text().replace(f"{line}(", f"{line}X(")


@pytest.mark.parametrize("what", ["placement", "storey", "axes", "body", "item", "unit"])
def test_a_dropped_line_that_says_where_or_what_something_is_makes_everything_doubtful(read, what):
    model, (_, stud), _ = two_studs()
    shape = stud.Representation.Representations[0]
    lines = {
        "placement": stud.ObjectPlacement,
        "storey": model.storey.ObjectPlacement,
        "axes": stud.ObjectPlacement.RelativePlacement,
        "body": stud.Representation,
        "item": shape.Items[0],
        "unit": model.project.UnitsInContext.Units[1],
    }
    found = read(renamed(model, lines[what]))
    assert all(element.doubt for element in found.elements.values())


def test_a_body_of_which_a_part_was_dropped_is_a_box(read):
    model, (stud, _), _ = two_studs()
    profile = stud.Representation.Representations[0].Items[0].SweptArea
    found = read(renamed(model, profile)).elements
    assert found[stud.GlobalId].doubt and found[stud.GlobalId].bodies[0].vertices[:, 2].max() >= STUD[2]


def test_a_wrong_value_of_who_made_it_is_told_and_nobody_doubts(read):
    model, (stud, _), _ = two_studs()
    person = model.make("IfcPerson", FamilyName="A", Roles=[model.make("IfcActorRole", "ARCHITECT")])
    whose = model.make("IfcPersonAndOrganization", person, model.make("IfcOrganization", Name="O"))
    program = model.make("IfcApplication", whose.TheOrganization, "1", "P", "P")
    stud.OwnerHistory = model.make("IfcOwnerHistory", whose, program, None, "ADDED", None, None, None, 1)
    found = read(model.text().replace(".ARCHITECT.", ".architect."))
    assert found.notes and not any(element.doubt for element in found.elements.values())


def test_a_dropped_opening_is_doubted_at_its_wall(read):
    model, (stud, _), _ = two_studs()
    opening = model.opening(stud, (0.05, 0.05, 0.3), (0, 0, 0.2))
    assert read(renamed(model, opening)).elements[stud.GlobalId].doubt


def test_a_value_of_an_unknown_kind_is_doubted_at_its_element(read):
    model, (stud, other), _ = two_studs()
    model.properties(stud, "Pset_MemberCommon", Reference="r")
    found = read(model.text().replace("IFCLABEL('r')", "IFCLABELX('r')")).elements
    assert "IFCLABELX" in found[stud.GlobalId].doubt and not found[other.GlobalId].doubt


def half(model):
    """A member of two items, of which the kernel makes only one."""
    low, high = (model.extrusion(model.rectangle(1.0, 0.1), 0.1, at=(0, 0, z)) for z in (0.0, 0.5))
    high.Depth = 0.0
    return model.element("IfcMember", "half", model.representation(low, high))


def turned(model):
    """A member with a full turn about an axis through the profile: the kernel makes nothing of it, and says nothing."""
    axis = model.make("IfcAxis1Placement", model.point(0.0, 0.0, 0.0), model.make("IfcDirection", [1.0, 0.0, 0.0]))
    place = model.axes((0.0, 0.0, 0.5))
    ring = model.make("IfcRevolvedAreaSolid", model.rectangle(1.0, 0.1), place, axis, 2.0 * np.pi)
    bar = model.extrusion(model.rectangle(1.0, 0.1), 0.1)
    return model.element("IfcMember", "turned", model.representation(bar, ring))


def unclipped(model):
    """A member whose clipping plane has no direction."""
    plane = model.make("IfcPlane", model.axes((0.0, 0.0, 0.05), z=(0.0, 0.0, 0.0)))
    cut = model.make("IfcHalfSpaceSolid", plane, False)
    body = model.make("IfcBooleanClippingResult", "DIFFERENCE", model.extrusion(model.rectangle(1.0, 0.1), 0.1), cut)
    return model.element("IfcMember", "whole", model.representation(body, kind="Clipping"))


@pytest.mark.parametrize(
    ("make", "doubt"),
    [
        (half, "cannot make a part of its shape"),
        (turned, "cannot make a part of its shape"),
        (unclipped, "the reader of the file says of what it needs"),
    ],
)
def test_a_body_of_which_the_kernel_makes_less_or_more_is_not_placed(read, make, doubt):
    model = IfcModel()
    member = make(model)
    model.task("place", [member])
    found = read(model)
    assert doubt in found.elements[member.GlobalId].doubt
    assert remarked(found, member, doubt, "the arm does not place it")


@pytest.mark.parametrize("opening", [False, True])
def test_items_that_are_all_made_and_lines_beside_them_are_no_doubt(read, opening):
    model = IfcModel()
    items = [model.extrusion(model.rectangle(1.0, 0.1), 0.1, at=(0, 0, z)) for z in (0.0, 0.1)]
    line = model.make("IfcPolyline", [model.point(0.0, 0.0, 0.0), model.point(1.0, 0.0, 0.0)])
    member = model.element("IfcMember", "whole", model.representation(*items, line))
    if opening:
        model.opening(member, (0.1, 0.02, 0.05), (0, 0, 0.05))
    assert read(model).elements[member.GlobalId].doubt == ""


def csg(model):
    """A block."""
    return model.make("IfcCsgSolid", model.make("IfcBlock", model.axes(), 100.0, 100.0, 100.0))


def surfaces(model, kind, shell):
    """A square as a surface model."""
    points = [model.point(*corner, 0.0) for corner in ((0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1))]
    bound = model.make("IfcFaceOuterBound", model.make("IfcPolyLoop", points), True)
    return model.make(kind, [model.make(shell, [model.make("IfcFace", [bound])])])


@pytest.mark.parametrize(
    "make",
    [
        csg,
        lambda model: surfaces(model, "IfcFaceBasedSurfaceModel", "IfcConnectedFaceSet"),
        lambda model: surfaces(model, "IfcShellBasedSurfaceModel", "IfcOpenShell"),
    ],
)
def test_items_that_the_kernel_calls_by_their_parts_are_no_doubt(read, make):
    model = IfcModel()
    member = model.element("IfcMember", "m", model.representation(make(model), kind="SolidModel"))
    found = read(model).elements[member.GlobalId]
    assert found.bodies and found.doubt == ""


# -- units, masses, places


def test_units_that_the_kernel_cannot_read_and_two_projects_are_refused(read):
    model = IfcModel(unit="inch")
    inch = model.project.UnitsInContext.Units[0]
    factor = model.make("IfcMeasureWithUnit", model.make("IfcLengthMeasure", 12.0), inch)
    foot = model.make("IfcConversionBasedUnit", inch.Dimensions, "LENGTHUNIT", "FOOT", factor)
    model.project.UnitsInContext.Units = [foot, *model.project.UnitsInContext.Units[1:]]
    model.box("box", (1.0, 0.1, 0.1))
    with pytest.raises(BuildingError, match="a unit of length of the SI"):
        read(model)
    model = two_studs()[0]
    model.root("IfcProject", Name="other", UnitsInContext=model.project.UnitsInContext)
    with pytest.raises(BuildingError, match="IFCPROJECT: found 2"):
        read(model)


def kilograms(model):
    """Give the project a unit of mass."""
    kilogram = model.make("IfcSIUnit", UnitType="MASSUNIT", Prefix="KILO", Name="GRAM")
    model.project.UnitsInContext.Units = [*model.project.UnitsInContext.Units, kilogram]


@pytest.mark.parametrize("weight", [0.0, -4.2])
def test_a_weight_of_nothing_or_less_is_told(read, weight):
    model, (stud, _), _ = two_studs()
    kilograms(model)
    model.weigh(stud, weight)
    found = read(model)
    assert found.elements[stud.GlobalId].mass is None and remarked(found, stud, "Weights that are not above 0")


def test_a_body_without_a_placement_and_a_context_that_is_elsewhere_are_told(read):
    model, (stud, _), _ = two_studs()
    stud.ObjectPlacement = None
    assert remarked(read(model), stud, "HAS A BODY AND NO PLACEMENT")
    model = two_studs()[0]
    model.context.WorldCoordinateSystem = model.axes((10.0, 0.0, 0.0), z=(0, 0, 1), x=(0, 1, 0))
    assert read(model).notes == (
        "The context's world coordinate system is left out: poses are those of the placements",
    )


def test_a_second_body_and_an_opening_without_one_are_told(read):
    model, (double, holed), _ = two_studs()
    shape = double.Representation
    more = model.representation(model.extrusion(model.rectangle(2.0, 0.2), 0.2))
    shape.Representations = [*shape.Representations, more]
    hole = model.element("IfcOpeningElement", "hole", within=holed)
    model.root("IfcRelVoidsElement", RelatingBuildingElement=holed, RelatedOpeningElement=hole)
    found = read(model)
    assert remarked(found, double, "Elements with 2 bodies of one kind")
    assert remarked(found, holed, "Openings without a body") and len(found.notes) == 2


def test_a_file_that_the_parser_refuses_is_told_with_its_reason(read):
    text = two_studs()[0].text().replace("'a'", "'a\\X\\ZZ'")
    with pytest.raises(BuildingError, match="the file: found Unexpected 'Z'"):
        read(text)
