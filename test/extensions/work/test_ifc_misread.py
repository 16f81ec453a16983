"""Models that are easily misread: each is read right, refused, or noted at the element or task that it is about."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ifc_models import IfcModel, noted, remarked, two_studs

from construction_twin.extensions.work.building import BuildingError, workpieces
from construction_twin.extensions.work.ifc.reader import read_ifc
from construction_twin.extensions.work.schedule import Schedule, propose

BOARD = (1.2, 2.4, 0.0125)
LITRES = 36.0
POUND, CUBIC_FOOT = 0.45359237, 0.3048**3
UNREAD = "the reader of the file says of what it needs"


def add_units(model: IfcModel, *units) -> None:
    """Give the project more units."""
    assignment = model.project.UnitsInContext
    assignment.Units = [*assignment.Units, *units]


def pound(model: IfcModel):
    """A pound."""
    kilogram = model.make("IfcSIUnit", UnitType="MASSUNIT", Prefix="KILO", Name="GRAM")
    factor = model.make("IfcMeasureWithUnit", model.make("IfcMassMeasure", POUND), kilogram)
    exponents = model.make("IfcDimensionalExponents", 0, 1, 0, 0, 0, 0, 0)
    return model.make("IfcConversionBasedUnit", exponents, "MASSUNIT", "pound", factor)


def density_unit(model: IfcModel, mass, length):
    """A mass per cube of a length."""
    elements = [model.make("IfcDerivedUnitElement", mass, 1), model.make("IfcDerivedUnitElement", length, -3)]
    return model.make("IfcDerivedUnit", elements, "MASSDENSITYUNIT")


def length_unit(model: IfcModel):
    """The project's."""
    return model.project.UnitsInContext.Units[0]


def of_material(model: IfcModel, element, name: str, density: float | None = None, unit=None):
    """Give an element a material with a density."""
    material = model.make("IfcMaterial", name)
    if density is not None:
        measure = model.make("IfcMassDensityMeasure", density)
        value = model.make("IfcPropertySingleValue", "MassDensity", None, measure, unit)
        model.make("IfcMaterialProperties", "Pset_MaterialCommon", None, [value], material)
    model.root("IfcRelAssociatesMaterial", RelatedObjects=[element], RelatingMaterial=material)


def board(model: IfcModel):
    """A plate of 36 l."""
    return model.box("board", BOARD, kind="IfcPlate")


# -- units and masses


def test_a_density_in_the_projects_own_unit_is_converted(read):
    model = IfcModel(unit="foot")
    heavy = pound(model)
    add_units(model, heavy, density_unit(model, heavy, length_unit(model)))
    plate = board(model)
    of_material(model, plate, "Gyp", 50.0)
    found = read(model)
    assert found.elements[plate.GlobalId].mass == pytest.approx(50.0 * POUND / CUBIC_FOOT * LITRES / 1e3)
    assert found.notes == ()


def test_a_quantity_and_a_property_have_units_of_their_own(read):
    model = IfcModel(unit="foot")
    tonne = model.make("IfcSIUnit", UnitType="MASSUNIT", Prefix="MEGA", Name="GRAM")
    plate, panel = board(model), board(model)
    add_units(model, pound(model))
    model.weigh(plate, 0.0288, tonne)
    metre = model.make("IfcSIUnit", UnitType="LENGTHUNIT", Name="METRE")
    of_material(model, panel, "Gypsum", 0.8, density_unit(model, tonne, metre))
    model.properties(panel, "Pset_PlateCommon", Reference="p")
    width = model.make("IfcPropertySingleValue", "Width", None, model.make("IfcPositiveLengthMeasure", 1.2), metre)
    own = model.root("IfcPropertySet", Name="Own", HasProperties=[width])
    model.root("IfcRelDefinesByProperties", RelatedObjects=[panel], RelatingPropertyDefinition=own)
    found = read(model)
    assert found.elements[plate.GlobalId].mass == pytest.approx(28.8)
    assert found.elements[panel.GlobalId].mass == pytest.approx(0.8 * LITRES)
    assert found.elements[panel.GlobalId].properties["Own"]["Width"] == pytest.approx(1.2)


def test_a_density_or_weight_of_feet_without_a_unit_is_not_guessed(read):
    model = IfcModel(unit="foot")
    dense, heavy = board(model), board(model)
    of_material(model, dense, "Gyp", 50.0)
    model.weigh(heavy, 63.5)
    found = read(model)
    assert [found.elements[one.GlobalId].mass for one in (dense, heavy)] == [None, None]
    assert remarked(found, dense, "a density of 50 has no unit")
    assert remarked(found, heavy, "A weight of 63.5", "without a unit can be kilograms or pounds")


def test_a_weight_of_a_metric_project_without_a_unit_of_mass_is_taken_as_kilograms_and_told(read):
    model = IfcModel()
    plate = board(model)
    model.weigh(plate, 28.8)
    found = read(model)
    assert found.elements[plate.GlobalId].mass == pytest.approx(28.8)
    assert noted(found.notes, "weights are taken as kilograms")
    model = IfcModel(unit="foot")
    own = board(model)
    model.weigh(own, 63.5, pound(model))
    found = read(model)
    assert found.elements[own.GlobalId].mass == pytest.approx(63.5 * POUND) and found.notes == ()


def test_a_density_that_nothing_has_gives_no_mass(read):
    model = IfcModel()
    plate = board(model)
    of_material(model, plate, "steel in kg per cubic millimetre", 7.85e-6)
    found = read(model)
    assert found.elements[plate.GlobalId].mass is None and remarked(found, plate, "THE MASS IS DOUBTFUL")


def test_a_price_takes_no_other_property_with_it(read):
    model = IfcModel()
    plate = board(model)
    euro = model.make("IfcMonetaryUnit", "EUR")
    price = model.make("IfcPropertySingleValue", "Price", None, model.make("IfcMonetaryMeasure", 12.0), euro)
    own = model.root("IfcPropertySet", Name="Cost", HasProperties=[price])
    model.root("IfcRelDefinesByProperties", RelatedObjects=[plate], RelatingPropertyDefinition=own)
    model.properties(plate, "Pset_PlateCommon", Status="EXISTING")
    found = read(model)
    assert found.elements[plate.GlobalId].status == "existing"
    assert remarked(found, plate, "a unit of their own that is none of theirs") and not noted(
        found.notes, "Property sets"
    )


@pytest.mark.parametrize("weight", [0.0288, 28.8, 2.0e6])
def test_a_mass_that_its_volume_cannot_have_is_doubted(read, weight):
    model = IfcModel()
    add_units(model, model.make("IfcSIUnit", UnitType="MASSUNIT", Prefix="KILO", Name="GRAM"))
    plate = board(model)
    model.weigh(plate, weight)
    found = read(model)
    assert found.elements[plate.GlobalId].mass == pytest.approx(weight)
    assert (
        (found.notes == ()) if weight == 28.8 else remarked(found, plate, "THE MASS IS DOUBTFUL", "expected 5 to 23000")
    )


# -- what is done, what stands, what goes


def completed_by_status(model, task):
    task.Status = "COMPLETED"


def completed_by_part(model, task):
    task.TaskTime = model.make("IfcTaskTime", Completion=1.0)


def completed_by_finish(model, task):
    task.TaskTime = model.make("IfcTaskTime", ActualFinish="2026-01-01T10:00:00")


def completed_by_what_it_nests_in(model, task):
    model.root("IfcRelNests", RelatingObject=model.task("before", Status="Completed"), RelatedObjects=[task])


@pytest.mark.parametrize(
    "complete",
    [
        completed_by_status,
        completed_by_part,
        completed_by_finish,
        completed_by_what_it_nests_in,
    ],
)
def test_what_is_completed_is_no_job_and_nobody_waits_for_it(read, complete):
    model, studs, (first, second) = two_studs()
    complete(model, first)
    schedule = Schedule.of(found := read(model))
    assert [(job.element, job.after) for job in schedule.jobs] == [(studs[1].GlobalId, ())]
    assert not noted(schedule.notes, "No task makes") and noted(found.notes, "Tasks that the file says are completed")


@pytest.mark.parametrize(("status", "part"), [("STARTED", None), (None, 0.5), (None, 100.0), ("who knows", None)])
def test_what_may_have_begun_is_a_job_with_a_remark(read, status, part):
    model, _, (first, _) = two_studs()
    first.Status = status
    if part is not None:
        first.TaskTime = model.make("IfcTaskTime", Completion=part)
    found = read(model)
    assert len(Schedule.of(found).jobs) == 2 and remarked(found, first, "taken as still to be done")


def test_where_a_part_is_above_1_none_says_completed(read):
    model, _, (first, second) = two_studs()
    first.TaskTime = model.make("IfcTaskTime", Completion=1.0)
    second.TaskTime = model.make("IfcTaskTime", Completion=50.0)
    found = read(model)
    assert len(Schedule.of(found).jobs) == 2 and remarked(found, first, "taken as still to be done")
    assert noted(found.notes, "(`Completion`) is above 1")


@pytest.mark.parametrize("status", ["NOT COMPLETED", "50% completed", "100%", "COMPLETED?", "Complete (QA ok)"])
def test_words_that_do_not_say_completed_are_not_taken_for_it(read, status):
    model, _, (first, _) = two_studs()
    first.Status = status
    found = read(model)
    assert len(Schedule.of(found).jobs) == 2 and remarked(found, first, "taken as still to be done")


@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.parametrize("status", ["CANCELLED", "canceled"])
def test_what_is_cancelled_is_no_job_and_nobody_waits_for_it(read, status, nested):
    model, studs, (first, _) = two_studs()
    if nested:
        model.root("IfcRelNests", RelatingObject=model.task("before", Status=status), RelatedObjects=[first])
    else:
        first.Status = status
        # what some programs write into a task that is given up
        first.TaskTime = model.make("IfcTaskTime", ActualFinish="2026-01-01T10:00:00")
    schedule = Schedule.of(found := read(model))
    assert [(job.element, job.after) for job in schedule.jobs] == [(studs[1].GlobalId, ())]
    assert remarked(found, first, "Tasks that the file says are cancelled") and len(found.notes) == 1
    assert schedule.removals == ()


@pytest.mark.parametrize("name", ["PSet_MemberCommon", "pset_membercommon", "PSET_MEMBERCOMMON"])
def test_a_status_is_read_of_a_common_set_in_any_case(read, name):
    model, studs, _ = two_studs()
    model.properties(studs[0], name, Status="Existing")
    assert read(model).elements[studs[0].GlobalId].status == "existing"


@pytest.mark.parametrize(
    "kind",
    [
        {"PredefinedType": "DEMOLITION"},
        {"PredefinedType": "REMOVAL"},
        {"PredefinedType": "DISMANTLE"},
        {"PredefinedType": "USERDEFINED", "ObjectType": "Demolition"},
    ],
)
def test_what_a_task_takes_down_is_no_job_and_what_comes_after_waits(read, kind):
    model = IfcModel()
    old, new = (model.box(name, (0.1, 0.1, 1.0), at=(k, 0, 0)) for k, name in enumerate(("old", "new")))
    down, up = model.task("take down", [old], **kind), model.task("place", [new])
    model.sequence(down, up)
    found = read(model)
    schedule = Schedule.of(found)
    assert [job.element for job in schedule.jobs] == [new.GlobalId]
    assert [(job.id, job.element) for job in schedule.removals] == [(down.GlobalId, old.GlobalId)]
    assert [wait.job for wait in schedule.jobs[0].after] == [down.GlobalId]
    assert any(f"twin work removed {down.GlobalId}" in note for note in schedule.notes)


def test_a_task_that_only_looks_after_something_places_nothing(read):
    model, studs, (first, _) = two_studs()
    first.PredefinedType = "MAINTENANCE"
    found = read(model)
    schedule = Schedule.of(found)
    assert [job.element for job in schedule.jobs] == [studs[1].GlobalId] and schedule.removals == ()
    assert remarked(found, first, "which places nothing")


def test_what_exists_or_goes_is_not_proposed(read):
    model = IfcModel()
    kept, gone, new = (model.box(name, (0.1, 0.1, 1.0), at=(k, 0, 0)) for k, name in enumerate(("kept", "gone", "new")))
    model.properties(kept, "Pset_MemberCommon", Status="EXISTING")
    model.properties(gone, "Pset_MemberCommon", Status="DEMOLISH")
    found = read(model)
    assert workpieces(found) == (new.GlobalId,)
    schedule = Schedule.of(propose(found), True)
    assert [job.element for job in schedule.jobs] == [new.GlobalId]
    assert [(job.id, job.element) for job in schedule.removals] == [(f"{gone.GlobalId}/removal", gone.GlobalId)]
    assert remarked(found, kept, "Existing elements: obstacles")
    assert remarked(found, gone, "Elements to be taken down")


def test_what_is_to_go_and_is_given_to_a_task_without_a_kind_is_taken_down_by_it(read):
    model, studs, (first, second) = two_studs()
    model.properties(studs[0], "Pset_MemberCommon", Status="DEMOLISH")
    schedule = Schedule.of(read(model))
    assert [job.id for job in schedule.removals] == [first.GlobalId]
    assert [(job.id, [wait.job for wait in job.after]) for job in schedule.jobs] == [
        (second.GlobalId, [first.GlobalId])
    ]


def test_what_a_task_places_and_another_takes_down_stays_with_a_note(read):
    model, studs, (first, second) = two_studs()
    down = model.task("take down a", [studs[0]], PredefinedType="REMOVAL")
    model.sequence(second, down)
    schedule = Schedule.of(read(model))
    assert len(schedule.jobs) == 2 and schedule.removals == ()
    assert noted(schedule.notes, "which another task places")


# -- what the parser drops


def text_of_two() -> str:
    model, _, _ = two_studs()
    return model.text()


def doubts_of(found) -> list[str]:
    """The doubts of all elements, of each what stands before a colon."""
    return [element.doubt.split(":")[0] for element in found.elements.values()]


def test_elements_of_tasks_whose_order_is_of_an_unknown_kind_are_doubted(read):
    model, _, _ = two_studs()
    model.box("c", (0.1, 0.1, 1.0), at=(2, 0, 0))
    found = read(model.text().replace("IFCRELSEQUENCE", "IFCRELSEQUENZE"))
    assert found.sequences == () and noted(found.notes, "The parser says", "IFCRELSEQUENZE")
    assert doubts_of(found) == [UNREAD, UNREAD, ""]
    # what is lost says nothing of their bodies
    assert all(each.bodies[0].volume == pytest.approx(0.01) for each in found.elements.values())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text[: text.index("IFCRELSEQUENCE") + 15] + "\nENDSEC;\nEND-ISO-10303-21;\n", "broken off"),
        (lambda text: text.replace("'place b'", "'place b"), "the file"),
        (lambda text: text.replace("\n#12=", "\n#11="), "refers to #12, which is not there"),
    ],
)
def test_half_a_file_is_refused(read, change, words):
    with pytest.raises(BuildingError, match=words):
        read(change(text_of_two()))


def test_a_file_with_comments_is_read(read):
    commented = (
        text_of_two().replace("DATA;", "DATA;\n/* it's a 'stud' */ /**/ /* ** / */").replace("#12=", "/* #1 */#12=")
    )
    found = read("/* a */ /* b */\n" + commented)
    assert doubts_of(found) == ["", ""] and found.notes == () and len(found.sequences) == 1


_TEXT = text_of_two()
_DATA, _ENDSEC = _TEXT.index("DATA;"), _TEXT.rindex("ENDSEC;")


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(_DATA + 6, _ENDSEC - 1))
def test_a_file_cut_inside_of_a_line_is_refused_or_doubted(tmp_path_factory, cut):
    kept = _TEXT[:cut]
    if kept.rstrip().endswith((";", ")")):
        return
    path = tmp_path_factory.mktemp("cut") / "cut.ifc"
    path.write_text(f"{kept}\nENDSEC;\nEND-ISO-10303-21;\n")
    try:
        found = read_ifc(path, 1 << 24)
    except BuildingError:
        return
    assert not found.elements or any(doubts_of(found))


def test_a_line_with_too_few_values_is_told(read):
    model, studs, _ = two_studs()
    line = next(line for line in model.text().splitlines() if f"'{studs[0].GlobalId}'" in line)
    found = read(model.text().replace(line, line.replace(",$,$);", ");")))
    assert doubts_of(found) == [UNREAD, ""] and noted(found.notes, "The parser says", "Expected 9 attribute values")


@pytest.mark.parametrize(("code", "called"), [("utf-8", "UTF-8"), ("cp1252", "Latin-1"), ("utf-8-sig", "UTF-8")])
def test_letters_that_are_not_ascii_are_kept_and_told(read, code, called):
    model, _, _ = two_studs()
    found = read(model.text().replace("'a'", "'Brücke Süd'").encode(code))
    assert "Brücke Süd" in [element.name for element in found.elements.values()]
    assert noted(found.notes, f"not ASCII, which IFC does not allow; taken as {called}")


# -- shapes


@pytest.mark.parametrize("mapped", [False, True])
@pytest.mark.parametrize(
    "corners",
    [
        [(0.0, 0.0), (1.0, 0.1), (1.0, 0.0), (0.0, 0.1)],
        [(0.0, 0.0), (1.0, 0.0), (1.0, 0.1), (0.2, 0.1), (0.2, -0.1), (0.0, -0.1)],
    ],
)
def test_a_profile_that_crosses_itself_is_a_box_and_no_job_without_doubt(read, corners, mapped):
    model = IfcModel()
    body = model.extrusion(model.polygon(corners), 0.1)
    if mapped:
        body = model.representation(model.mapped(model.representation(body)), kind="MappedRepresentation")
    bow = model.element("IfcMember", "bow", body)
    of_material(model, bow, "Wood", 420.0)
    found = read(model)
    element = found.elements[bow.GlobalId]
    assert UNREAD in element.doubt and element.mass is None
    assert remarked(found, bow, "the arm does not place it", UNREAD)
    (box,) = element.bodies
    assert box.is_closed
    assert (box.vertices.min(axis=0) <= [*np.min(corners, axis=0), 0.0]).all()
    assert (box.vertices.max(axis=0) >= [*np.max(corners, axis=0), 0.1]).all()


# -- assemblies, calendars, what is not read


def test_a_task_that_makes_an_assembly_places_its_parts_once_a_person_accepts_their_order(read):
    model = IfcModel()
    panel = model.element("IfcElementAssembly", "panel")
    upper = model.box("upper", (1.0, 0.1, 0.1), at=(0.0, 0.0, 0.1), within=panel)
    lower = model.box("lower", (1.0, 0.1, 0.1), within=panel)
    other = model.box("other", (1.0, 0.1, 0.1), at=(0.0, 1.0, 0.0), within=panel)
    model.aggregate(panel, [upper, lower, other])
    task, own = model.task("panel up", [panel]), model.task("other up", [other])
    schedule = Schedule.of(read(model))
    assert [(job.task, job.element) for job in schedule.jobs] == [
        (task.GlobalId, lower.GlobalId), (task.GlobalId, upper.GlobalId), (own.GlobalId, other.GlobalId),
    ]  # fmt: skip
    assert schedule.proposed and noted(schedule.notes, "which has no body of its own: what is in it")


# -- schemas and contexts


@pytest.mark.parametrize(
    ("schema", "given"),
    [
        *(("IFC4X3", name) for name in ("IFC4X3", "IFC4X3_TC1", "ifc4x3_add1")),
        *(("IFC4", name) for name in ("IFC4_ADD2", "IFC4_ADD2_TC1")),
        ("IFC2X3", "IFC2X3_TC1"),
    ],
)
def test_every_publication_of_a_schema_is_read_as_its_last(read, schema, given):
    model, _, _ = two_studs(schema)
    text = model.text().replace(f"'{'IFC4X3_ADD2' if schema == 'IFC4X3' else schema}'", f"'{given}'")
    assert f"'{given}'" in text
    found = read(text)
    assert (len(found.tasks), doubts_of(found)) == (2, ["", ""])


def test_a_release_candidate_is_refused_by_name(read):
    with pytest.raises(BuildingError, match="schema: found IFC4X3_RC4, expected one of IFC2X3, IFC4, IFC4X3"):
        read(text_of_two().replace("'IFC4'", "'IFC4X3_RC4'"))


def test_a_project_library_beside_the_project_changes_nothing(read):
    model, _, _ = two_studs()
    library = model.root("IfcProjectLibrary", Name="parts")
    model.root("IfcRelDeclares", RelatingContext=model.project, RelatedDefinitions=[library])
    assert doubts_of(read(model)) == ["", ""]
