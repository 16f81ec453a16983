"""IFC files as building models: units, placements, bodies, properties, in three schemas. Read in this process: harmless files."""

from __future__ import annotations

import numpy as np
import pytest
from ifc_models import IfcModel, noted

from construction_twin.extensions.work.building import workpieces

SCHEMAS = ("IFC2X3", "IFC4", "IFC4X3")


def only(model):
    """The only element."""
    (element,) = model.elements.values()
    return element


def corners(body):
    """Smallest and largest corner."""
    return body.vertices.min(axis=0), body.vertices.max(axis=0)


@pytest.mark.parametrize("schema", SCHEMAS)
@pytest.mark.parametrize("unit", ["m", "mm", "foot", "inch"])
def test_a_box_is_the_same_in_every_unit_and_schema(read, schema, unit):
    model = IfcModel(schema, unit)
    model.box("stud", (0.1, 0.06, 2.4), at=(1.0, 2.0, 0.5))
    found = read(model)
    element = only(found)
    assert (element.ifc_class, element.name) == ("IfcMember", "stud")
    assert element.model_T_element.position == pytest.approx([1.0, 2.0, 0.5])
    (body,) = element.bodies
    low, high = corners(body)
    assert np.concatenate([low, high]) == pytest.approx([-0.05, -0.03, 0, 0.05, 0.03, 2.4], abs=1e-9)
    assert body.is_closed
    assert body.volume == pytest.approx(0.1 * 0.06 * 2.4)


def test_placements_are_multiplied_up_to_the_model(read):
    model = IfcModel()
    assembly = model.element("IfcElementAssembly", "panel", at=(10.0, 0.0, 0.0))
    assembly.ObjectPlacement = model.placement((10.0, 0.0, 0.0), model.storey, z=(0, 0, 1), x=(0, 1, 0))
    part = model.box("stud", (0.1, 0.1, 1.0), at=(1.0, 0.0, 0.0), within=assembly)
    model.aggregate(assembly, [part])
    found = read(model)
    stud = found.elements[part.GlobalId]
    assert stud.model_T_element.position == pytest.approx([10.0, 1.0, 0.0])
    assert stud.model_T_element.rotation == pytest.approx(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), abs=1e-12)
    assert stud.assembly == assembly.GlobalId
    assert found.elements[assembly.GlobalId].bodies == ()
    assert workpieces(found) == (part.GlobalId,)


def test_mapped_items_are_bodies_wherever_they_are_put(read):
    model = IfcModel()
    source = model.representation(model.extrusion(model.rectangle(0.2, 0.1), 1.0))
    mapped = model.representation(
        model.mapped(source), model.mapped(source, scale=2.0, at=(5.0, 0.0, 0.0)), kind="MappedRepresentation"
    )
    model.element("IfcBeam", "beam", mapped)
    first, second = sorted(only(read(model)).bodies, key=lambda body: body.vertices[:, 0].mean())
    assert np.concatenate(corners(first)) == pytest.approx([-0.1, -0.05, 0.0, 0.1, 0.05, 1.0])
    assert np.concatenate(corners(second)) == pytest.approx([4.8, -0.1, 0.0, 5.2, 0.1, 2.0])


def test_an_opening_is_cut_out(read):
    model = IfcModel()
    wall = model.box("wall", (4.0, 0.2, 2.5), kind="IfcWall")
    model.opening(wall, (1.0, 1.0, 1.0), at=(0.0, 0.0, 0.5))
    found = only(read(model))
    (body,) = found.bodies
    assert body.volume == pytest.approx(4 * 0.2 * 2.5 - 0.2)


def test_a_hole_of_a_polygon_is_a_hole(read):
    model = IfcModel()
    profile = model.polygon([(0, 0), (0, 2), (2, 2), (2, 0)], [(0.5, 0.5), (1.5, 0.5), (1.5, 1.5), (0.5, 1.5)])
    model.element("IfcSlab", "slab", profile)
    (body,) = only(read(model)).bodies
    assert body.volume == pytest.approx(3)


def test_values_are_si_and_the_elements_win_over_the_types(read):
    model = IfcModel(unit="inch")
    beam = model.box("beam", (0.1, 0.1, 1.0), kind="IfcBeam")
    kind = model.root("IfcBeamType", Name="B1", PredefinedType="BEAM")
    length = model.make("IfcPositiveLengthMeasure", 100.0)
    shared = model.root(
        "IfcPropertySet",
        Name="Pset_BeamCommon",
        HasProperties=[
            model.make("IfcPropertySingleValue", Name="Span", NominalValue=length),
            model.make("IfcPropertySingleValue", Name="Status", NominalValue=model.make("IfcLabel", "type")),
        ],
    )
    kind.HasPropertySets = [shared]
    model.root("IfcRelDefinesByType", RelatedObjects=[beam], RelatingType=kind)
    model.properties(beam, "Pset_BeamCommon", Status="element", IsExternal=True)
    model.properties(beam, "CTwin_RobotTask", Grip="top", Speed=0.25)
    found = only(read(model))
    assert found.type_name == "B1"
    assert found.properties["Pset_BeamCommon"] == {"Span": pytest.approx(2.54), "Status": "element", "IsExternal": True}
    assert found.properties["CTwin_RobotTask"] == {"Grip": "top", "Speed": 0.25}


@pytest.mark.parametrize("schema", SCHEMAS)
def test_a_mass_is_the_quantitys_or_density_times_volume(read, schema):
    model = IfcModel(schema)
    weighed = model.box("weighed", (0.1, 0.1, 1.0))
    model.weigh(weighed, 7.5)
    timber = model.box("timber", (0.1, 0.1, 1.0))
    material = model.make("IfcMaterial", Name="Spruce")
    if schema == "IFC2X3":
        model.make("IfcGeneralMaterialProperties", Material=material, MassDensity=450.0)
    else:
        density = model.make(
            "IfcPropertySingleValue", Name="MassDensity", NominalValue=model.make("IfcMassDensityMeasure", 450.0)
        )
        model.make("IfcMaterialProperties", Name="Pset_MaterialCommon", Properties=[density], Material=material)
    model.root("IfcRelAssociatesMaterial", RelatedObjects=[timber], RelatingMaterial=material)
    unknown = model.box("unknown", (0.1, 0.1, 1.0))
    found = read(model).elements
    assert found[weighed.GlobalId].mass == pytest.approx(7.5)
    assert found[timber.GlobalId].mass == pytest.approx(4.5)
    assert found[unknown.GlobalId].mass is None


def test_only_what_is_delivered_in_one_piece_is_a_workpiece(read):
    model = IfcModel("IFC2X3")
    made = {
        kind: model.box(kind, (0.1, 0.1, 1.0), kind=kind).GlobalId
        for kind in ("IfcBeam", "IfcWallStandardCase", "IfcDoor", "IfcFurnishingElement", "IfcBuildingElementProxy")
    }
    twice = model.representation(
        model.extrusion(model.rectangle(1, 0.1), 1.0), model.extrusion(model.rectangle(1, 0.1), 1.0, at=(0, 1, 0))
    )
    made["two bodies"] = model.element("IfcWall", "two leaves", twice).GlobalId
    found = read(model)
    assert set(workpieces(found)) == {
        made[each] for each in ("IfcBeam", "IfcWallStandardCase", "IfcBuildingElementProxy")
    }


def test_holes_rooms_and_drawings_are_no_elements(read):
    model = IfcModel()
    wall = model.box("wall", (4.0, 0.2, 2.5), kind="IfcWall")
    model.opening(wall, (1.0, 1.0, 1.0))
    model.box("room", (1.0, 1.0, 1.0), kind="IfcSpace")
    assert list(read(model).elements) == [wall.GlobalId]


def test_a_whole_that_its_parts_fill_gives_its_body_to_them(read):
    model = IfcModel()
    wall = model.box("wall", (1.0, 0.2, 1.0), kind="IfcWall")
    parts = [
        model.box("layer", (1.0, 0.1, 1.0), at=(0, y, 0), kind="IfcBuildingElementPart", within=wall)
        for y in (-0.05, 0.05)
    ]
    model.aggregate(wall, parts)
    found = read(model)
    assert found.elements[wall.GlobalId].bodies == ()
    assert workpieces(found) == tuple(part.GlobalId for part in parts)
    assert noted(found.notes, "Has a body and parts that fill it")


def test_a_map_conversion_is_told_and_left_out(read):
    model = IfcModel()
    model.box("stud", (0.1, 0.1, 1.0), at=(1.0, 0.0, 0.0))
    crs = model.make("IfcProjectedCRS", Name="EPSG:25832")
    model.make("IfcMapConversion", model.context, crs, 500000.0, 5800000.0, 50.0, 0.6, 0.8)
    found = read(model)
    assert only(found).model_T_element.position == pytest.approx([1.0, 0.0, 0.0])
    assert noted(found.notes, "The map conversion is left out")


def test_two_elements_of_one_globalid_are_told_apart(read):
    model = IfcModel()
    first, second = model.box("a", (0.1, 0.1, 1.0)), model.box("b", (0.1, 0.1, 1.0))
    second.GlobalId = first.GlobalId
    found = read(model)
    assert list(found.elements) == [first.GlobalId, f"#{second.id()}"]
    assert noted(found.notes, "Named by the number in the file")
