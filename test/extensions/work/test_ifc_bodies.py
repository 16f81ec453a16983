"""Bodies of which nobody can be sure: none is read as something else in silence, and each is an obstacle at least as its box."""

from __future__ import annotations

import numpy as np
import pytest
from ifc_models import IfcModel

from construction_twin.extensions.work.ifc.geometry import bounds
from construction_twin.extensions.work.ifc.reader import read_ifc

UNMADE = "the geometry kernel cannot make its shape"
BOX = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]


@pytest.fixture
def read(tmp_path):
    """Write a model and read the elements of it again, by name."""

    def write_and_read(model):
        found = read_ifc(model.save(tmp_path / "model.ifc"), 1 << 24)
        return {element.name: element for element in found.elements.values()}

    return write_and_read


def corners(low, high):
    """Of a box."""
    (a, b, c), (d, e, f) = low, high
    return [(a, b, c), (d, b, c), (d, e, c), (a, e, c), (a, b, f), (d, b, f), (d, e, f), (a, e, f)]


def shell(model, *faces):
    """Faces by their corners as a closed shell."""
    made = []
    for face in faces:
        loop = model.make("IfcPolyLoop", [model.point(*map(float, corner)) for corner in face])
        made.append(model.make("IfcFace", [model.make("IfcFaceOuterBound", loop, True)]))
    return model.make("IfcClosedShell", made)


def box_faces(low, high, inwards=False):
    """Faces of a box by their corners."""
    points = corners(low, high)
    faces = [[points[k] for k in face] for face in BOX]
    return [face[::-1] for face in faces] if inwards else faces


def plate(model, name, *faces):
    """A plate of faces."""
    brep = model.make("IfcFacetedBrep", shell(model, *faces))
    return model.element("IfcPlate", name, model.representation(brep, kind="Brep"))


def whole(element):
    """Volume of its bodies [m³]."""
    return sum(body.volume for body in element.bodies)


def extent(element):
    """Smallest and largest corner."""
    points = np.concatenate([body.vertices for body in element.bodies])
    return points.min(axis=0), points.max(axis=0)


def holds(element, low, high) -> bool:
    """Whether its bodies reach at least from one corner to another."""
    least, most = extent(element)
    return bool((least <= np.array(low) + 1e-9).all() and (most >= np.array(high) - 1e-9).all())


def cylinder(model):
    """A round bar that the geometry kernel cannot make, 50 mm around the origin and 1.1 m high."""
    return model.make("IfcRightCircularCylinder", model.axes(), 1.1 / model.unit, 0.05 / model.unit)


def test_a_cavity_takes_its_volume_away(read):
    model = IfcModel()
    inner = box_faces((0.2, 0.2, 0.2), (0.8, 0.8, 0.8), inwards=True)
    plate(model, "cavity", *box_faces((0, 0, 0), (1, 1, 1)), *inner)
    found = read(model)["cavity"]
    assert found.doubt == "" and whole(found) == pytest.approx(1.0 - 0.6**3)


def test_a_face_too_many_drops_no_other(read):
    model = IfcModel()
    # a wall with a pane on its end, which closes nothing
    plate(model, "wall", *box_faces((0, 0, 0), (4, 0.2, 3)), [(4, 0, 0), (5, 0, 0), (5, 0, 1), (4, 0, 1)])
    assert holds(read(model)["wall"], (0, 0, 0), (5, 0.2, 3))


@pytest.mark.parametrize("operator", ["UNION", "DIFFERENCE"])
def test_a_part_that_the_kernel_cannot_make_is_in_the_box(read, operator):
    model = IfcModel()
    bar = model.extrusion(model.rectangle(0.2, 0.02), 1.0)
    body = model.make("IfcBooleanResult", operator, bar, cylinder(model))
    model.element("IfcMember", "bar", model.representation(body, kind="CSG"))
    found = read(model)["bar"]
    assert "the reader of the file says of what it needs" in found.doubt and found.mass is None
    assert holds(found, (-0.1, -0.05, 0.0), (0.1, 0.05, 1.1))


def test_what_the_kernel_cannot_make_at_all_is_a_box(read):
    model = IfcModel()
    model.element("IfcColumn", "round", model.representation(model.make("IfcCsgSolid", cylinder(model)), kind="CSG"))
    model.box("stud", (0.1, 0.1, 1.0), at=(3.0, 0.0, 0.0))
    found = read(model)
    assert UNMADE in found["round"].doubt and found["stud"].doubt == ""
    assert holds(found["round"], (-0.05, -0.05, 0.0), (0.05, 0.05, 1.1))


@pytest.mark.parametrize("turned", [False, True])
def test_the_box_of_what_the_kernel_cannot_make_holds_what_is_mapped_and_moved(read, turned):
    model = IfcModel()
    position = (
        model.axes((1.0, 2.0, 0.0), z=(1.0, 0.0, 0.0), x=(0.0, 1.0, 0.0)) if turned else model.axes((1.0, 2.0, 0.0))
    )
    bar = model.make("IfcRightCircularCylinder", position, 1.1 / model.unit, 0.05 / model.unit)
    source = model.map_of(model.representation(model.make("IfcCsgSolid", bar), kind="CSG"))
    mapped = model.representation(model.mapped(source, scale=2.0, at=(0.0, 0.0, 3.0)), kind="MappedRepresentation")
    model.element("IfcColumn", "round", mapped)
    low, high = ((2.0, 3.9, 2.9), (4.2, 4.1, 3.1)) if turned else ((1.9, 3.9, 3.0), (2.1, 4.1, 5.2))
    assert holds(read(model)["round"], low, high)


@pytest.mark.parametrize("whole_bar", [True, False])
def test_each_copy_of_a_mapped_body_is_doubted_with_the_others(read, whole_bar):
    model = IfcModel()
    bar = model.extrusion(model.rectangle(0.2, 0.02), 1.0)
    body = bar if whole_bar else model.make("IfcBooleanResult", "UNION", bar, cylinder(model))
    source = model.map_of(model.representation(body))
    for number, scale in enumerate((1.0, 1.0, 2.0)):
        mapped = model.representation(model.mapped(source, scale=scale), kind="MappedRepresentation")
        model.element("IfcMember", f"bar {number}", mapped).ObjectPlacement = model.placement((number, 2.0, 0.0))
    first, second, large = read(model).values()
    assert [bool(each.doubt) for each in (first, second, large)] == [not whole_bar] * 3
    assert [each.model_T_element.position[0] for each in (first, second, large)] == [0.0, 1.0, 2.0]
    if whole_bar:
        assert [whole(each) for each in (first, second, large)] == pytest.approx([0.004, 0.004, 0.032])


def test_copies_beside_an_alignment_each_stand_where_the_kernel_has_them(read):
    model = IfcModel("IFC4X3")
    way = model.make("IfcPolyline", [model.point(0.0, 0.0, 0.0), model.point(10.0, 0.0, 0.0)])
    at = model.make("IfcPointByDistanceExpression", model.make("IfcLengthMeasure", 3000.0), None, None, None, way)
    along = model.make("IfcLinearPlacement", None, model.make("IfcAxis2PlacementLinear", at), None)
    source = model.map_of(model.representation(model.extrusion(model.rectangle(0.2, 0.02), 1.0)))
    for number in range(2):
        post = model.element("IfcMember", f"post {number}", model.representation(model.mapped(source)))
        post.ObjectPlacement = model.make("IfcLocalPlacement", along, model.axes((float(number), 0.0, 0.0)))
    found = read(model)
    assert [found[f"post {number}"].model_T_element.position[0] for number in range(2)] == pytest.approx([3.0, 4.0])
    assert all(each.bodies and not each.doubt for each in found.values())


def test_a_body_without_a_triangle_refuses_no_other(read):
    model = IfcModel()
    flat = model.extrusion(model.rectangle(0.1, 0.1), 1.0)
    flat.Depth = 0.0
    model.element("IfcMember", "flat", flat)
    same = [model.extrusion(model.rectangle(0.1, 0.1), 1.0) for _ in range(2)]
    nothing = model.make("IfcBooleanResult", "DIFFERENCE", *same)
    model.element("IfcMember", "nothing", model.representation(nothing, kind="CSG"))
    model.box("stud", (0.1, 0.1, 1.0), at=(3.0, 0.0, 0.0))
    found = read(model)
    assert all(UNMADE in found[name].doubt for name in ("flat", "nothing")) and found["stud"].doubt == ""
    assert holds(found["nothing"], (-0.05, -0.05, 0.0), (0.05, 0.05, 1.0))


def test_one_that_the_kernel_cannot_place_takes_no_body_from_another(read):
    model = IfcModel()
    lost, _ = (model.box(name, (0.1, 0.1, 1.0), at=(3.0 * k, 0.0, 0.0)) for k, name in enumerate(("lost", "stud")))
    lines = [
        model.make("IfcPolyline", [model.make("IfcCartesianPoint", [0.0, 0.0]), model.make("IfcCartesianPoint", end)])
        for end in ([1.0, 0.0], [1.0, 0.0])
    ]
    axes = [model.make("IfcGridAxis", str(k), line, True) for k, line in enumerate(lines)]
    model.root("IfcGrid", UAxes=axes[:1], VAxes=axes[1:])
    crossing = model.make("IfcVirtualGridIntersection", axes, [0.0, 0.0])
    lost.ObjectPlacement = model.make("IfcGridPlacement", crossing)
    found = read(model)
    # where one stands is not known, so that none is placed; the other has its body
    assert list(found) == ["stud"] and found["stud"].doubt and whole(found["stud"]) == pytest.approx(0.01)


def test_what_is_cut_away_whole_is_a_box_and_doubted(read):
    model = IfcModel()
    eaten, ok = (model.box(name, (0.2, 0.2, 1.0), at=(k, 0, 0)) for k, name in enumerate(("eaten", "ok")))
    model.opening(eaten, (0.4, 0.4, 1.2), at=(0, 0, -0.1))
    swallowed = [model.extrusion(model.rectangle(size, size), size, at=(0, 0, -size / 4)) for size in (1.0, 3.0)]
    clipped = model.make("IfcBooleanResult", "DIFFERENCE", *swallowed)
    model.element("IfcBeam", "clipped", model.representation(clipped, kind="CSG"))
    found = read(model)
    assert "its openings cannot be cut out, or leave nothing" in found["eaten"].doubt
    assert UNMADE in found["clipped"].doubt and found["ok"].doubt == ""
    assert holds(found["eaten"], (-0.1, -0.1, 0.0), (0.1, 0.1, 1.0)) and found["ok"].id == ok.GlobalId


def test_an_opening_of_a_whole_is_cut_from_the_parts_that_it_meets(read):
    model = IfcModel()
    wall = model.element("IfcWall", "wall")
    parts = [
        model.box(name, (1.0, 0.1, 1.0), at=(x, 0, 0), kind="IfcBuildingElementPart", within=wall)
        for name, x in (("cut", 0.0), ("beside", 2.0))
    ]
    model.aggregate(wall, parts)
    model.opening(wall, (0.2, 0.4, 0.2), at=(0.0, 0.0, 0.4))
    found = read(model)
    assert [found[name].doubt for name in ("cut", "beside")] == ["", ""]
    assert [whole(found[name]) for name in ("cut", "beside")] == pytest.approx([0.1 - 0.004, 0.1])


def test_an_opening_flush_with_its_wall_leaves_no_skin(read):
    model = IfcModel(unit="m")
    wall = model.box("wall", (3.0, 0.3, 2.6), at=(0.1, 0.7, 0.3), kind="IfcWall")
    model.opening(wall, (0.9, 0.3, 1.2), at=(1.0 / 3.0, 0.0, 0.8))
    (body,) = read(model)["wall"].bodies
    assert body.is_closed and len(body.triangles) == 32


def test_a_box_that_stands_for_flat_faces_is_that_of_their_points():
    model = IfcModel(unit="m")
    points = model.make("IfcCartesianPointList3D", CoordList=((1.0, 2.0, 3.0), (5.0, 2.0, 3.0), (1.0, 2.2, 6.0)))
    faces = model.make("IfcTriangulatedFaceSet", Coordinates=points, CoordIndex=((1, 2, 3),))
    np.testing.assert_allclose(bounds(model.representation(faces, kind="Tessellation")), ((1, 2, 3), (5, 2.2, 6)))
    both = bounds(model.representation(faces, model.extrusion(model.rectangle(2.0, 0.2), 9.0), kind="SolidModel"))
    assert (both[0] <= (-1.0, -0.1, 0.0)).all() and (both[1] >= (5.0, 2.2, 9.0)).all()
