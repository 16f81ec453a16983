"""Parts come with their whole; what joins, fills, covers or projects is no obstacle before what it is on stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ifc_models import IfcModel, noted
from work_samples import box_pieces, building, element, robot, work_cell

from construction_twin.extensions.work.building import comes_after
from construction_twin.extensions.work.layout import Layout
from construction_twin.extensions.work.schedule import Schedule

STUD = (0.1, 0.1, 1.0)
NAIL = (0.01, 0.01, 0.2)


def panel(model, **attributes):
    """An assembly 10 m away of two studs and a nail, each weighed."""
    whole = model.element("IfcElementAssembly", "panel", at=(10.0, 0.0, 0.0), **attributes)
    parts = [
        model.weigh(model.box(name, STUD, at=(k, 0.0, 0.0), within=whole), 4.0) for k, name in enumerate(("a", "b"))
    ]
    nail = model.box("nail", NAIL, at=(0.0, 0.0, 0.9), kind="IfcMechanicalFastener", within=whole)
    model.aggregate(whole, [*parts, model.weigh(nail, 0.1)])
    return whole, parts, nail


# -- in one piece


@pytest.mark.parametrize("schema", ["IFC2X3", "IFC4", "IFC4X3"])
def test_an_assembly_from_a_factory_is_one_job_with_bodies_and_mass_of_all_its_parts(read, schema):
    model = IfcModel(schema)
    whole, parts, nail = panel(model, AssemblyPlace="FACTORY")
    task = model.task("erect", [whole])
    found = read(model)
    assert [(job.id, job.element) for job in Schedule.of(found).jobs] == [(task.GlobalId, whole.GlobalId)]
    made = found.elements[whole.GlobalId]
    points = np.concatenate([body.vertices for body in made.bodies])
    # in the assembly's own frame
    assert len(made.bodies) == 3 and made.mass == pytest.approx(8.1)
    assert np.allclose(points.min(axis=0), (-0.05, -0.05, 0.0)) and np.allclose(points.max(axis=0), (1.05, 0.05, 1.1))
    assert not any(found.elements[part.GlobalId].bodies for part in (*parts, nail))
    assert noted(found.notes, "Comes in one piece: its parts", "panel")


def test_an_assembly_from_a_factory_is_a_workpiece_without_a_schedule_too(read):
    model = IfcModel()
    whole, _, _ = panel(model, AssemblyPlace="FACTORY")
    window = model.box("window", (0.2, 0.2, 0.2), kind="IfcWindow")
    hole = model.opening(model.file.by_type("IfcMember")[0], (0.05, 0.05, 0.1), (0, 0, 0.3))
    model.root("IfcRelFillsElement", RelatingOpeningElement=hole, RelatedBuildingElement=window)
    found = read(model)
    # what fills a part of it comes with it; what it weighs is not said
    assert len(found.elements[whole.GlobalId].bodies) == 4 and found.elements[whole.GlobalId].mass is None
    assert noted(found.notes, "Comes in one piece with something whose mass is not known", "panel")
    assert not found.elements[window.GlobalId].bodies


def test_an_assembly_of_which_a_task_makes_a_part_is_made_of_its_parts(read):
    model = IfcModel()
    whole, (a, b), nail = panel(model, AssemblyPlace="FACTORY")
    model.task("place a", [a])
    model.task("place the rest", [whole])
    found = read(model)
    assert [job.element for job in Schedule.of(found).jobs] == [a.GlobalId, b.GlobalId]
    assert found.elements[nail.GlobalId].bodies


def slab(model):
    """A slab with a bar in it and a bracket on it, and a screw that fixes it to something."""
    whole = model.weigh(model.box("slab", (1.0, 0.2, 0.06), kind="IfcSlab"), 30.0)
    bar = model.weigh(model.box("bar", (0.01, 0.01, 0.2), kind="IfcReinforcingBar", within=whole), 0.2)
    screw = model.box("screw", NAIL, kind="IfcMechanicalFastener", within=whole)
    bracket = model.weigh(model.box("nib", (0.1, 0.1, 0.3), kind="IfcProjectionElement", within=whole), 1.0)
    model.aggregate(whole, [bar, screw])
    model.root("IfcRelProjectsElement", RelatingElement=whole, RelatedFeatureElement=bracket)
    return whole, bar, screw, bracket


def test_what_is_cast_in_comes_with_what_is_placed_and_screws_come_after(read):
    model = IfcModel()
    whole, bar, screw, bracket = slab(model)
    model.task("place", [whole])
    found = read(model)
    made = found.elements[whole.GlobalId]
    assert len(made.bodies) == 3 and made.mass == pytest.approx(31.2)
    assert not found.elements[bar.GlobalId].bodies and not found.elements[bracket.GlobalId].bodies
    assert comes_after(found.elements, [whole.GlobalId]) == {screw.GlobalId: {whole.GlobalId}}


def test_a_part_with_a_task_of_its_own_and_a_whole_that_nobody_places_are_elements_of_their_own(read):
    model = IfcModel()
    whole, bar, _, _ = slab(model)
    assert len(read(model).elements[whole.GlobalId].bodies) == 1
    model.task("place", [whole])
    model.task("fit the bar", [bar])
    found = read(model)
    assert found.elements[bar.GlobalId].bodies and found.elements[whole.GlobalId].mass == pytest.approx(31.0)
    assert [job.element for job in Schedule.of(found).jobs] == [whole.GlobalId, bar.GlobalId]


# -- afterwards


def part(name, of="", on=(), **changes):
    return replace(
        element(name, ifc_class=changes.pop("ifc_class", "IfcMechanicalFastener")), assembly=of, on=on, **changes
    )


def after(*elements, placed):
    return comes_after({one.id: one for one in elements}, placed)


def test_a_nail_of_a_panel_comes_when_all_of_the_panel_that_is_placed_stands():
    whole, left, right = part("panel", "house", bodies=()), part("l", "panel"), part("r", "panel")
    other = part("other", "house")
    found = after(
        whole, part("house", bodies=()), left, right, other, part("nail", "panel"), placed=["l", "r", "other"]
    )
    assert found == {"nail": {"l", "r"}}


def test_what_fastens_two_comes_when_both_stand_and_what_is_on_that_then_too():
    found = after(part("a"), part("b"), part("bolt", on=("a", "b")), part("cap", on=("bolt",)), placed=["a", "b"])
    assert found == {"bolt": {"a", "b"}, "cap": {"a", "b"}}


def test_a_window_comes_when_what_its_wall_is_made_of_stands_and_at_once_in_a_wall_that_exists():
    new, old = part("new", bodies=()), part("old", status="existing")
    stud, board = part("stud", "new"), part("board", "old")
    windows = part("w1", on=("new",)), part("w2", on=("old",))
    assert after(new, old, stud, board, *windows, placed=["stud", "board"]) == {"w1": {"stud"}}


def test_a_workpiece_beside_those_that_tasks_place_is_an_obstacle():
    whole, left, right = part("panel", bodies=()), part("l", "panel"), part("r", "panel", ifc_class="IfcMember")
    assert after(whole, left, right, placed=["l"]) == {}
    # a board on what is placed is not
    assert after(left, part("board", on=("l",), ifc_class="IfcCovering"), placed=["l"]) == {"board": {"l"}}


def test_what_is_on_an_element_is_in_the_scene_when_that_stands(tmp_path):
    at = work_cell(tmp_path)
    model = building(element("b"), element("c"), part("nail", on=("b",)))
    pieces = {name: box_pieces(model.element(name)) for name in model.elements}
    layout = Layout(at, model, pieces, ["b", "c"], robot().tip_link, {"nail": pieces["nail"]})
    assert "nail/0" not in layout.scene().names
    assert "nail/0" not in layout.scene({"c": layout.base_T_goal("c")}).names
    stands = layout.scene({"b": layout.base_T_goal("b")})
    assert "nail/0" in stands.names and stands.get("nail/0").fixed


# -- as the file says it


def test_fillings_coverings_and_fasteners_are_read(read):
    model = IfcModel()
    wall, post = model.box("wall", (2.0, 0.1, 2.0), kind="IfcWall"), model.box("post", STUD)
    window, board = model.box("window", STUD, kind="IfcWindow"), model.box("board", STUD, kind="IfcCovering")
    bolt = model.box("bolt", NAIL, kind="IfcMechanicalFastener")
    hole = model.opening(wall, (0.5, 0.1, 0.5), (0, 0, 1.0))
    model.root("IfcRelFillsElement", RelatingOpeningElement=hole, RelatedBuildingElement=window)
    model.root("IfcRelCoversBldgElements", RelatingBuildingElement=wall, RelatedCoverings=[board])
    model.root(
        "IfcRelConnectsWithRealizingElements", RelatingElement=wall, RelatedElement=post, RealizingElements=[bolt]
    )
    found = read(model).elements
    assert found[window.GlobalId].on == found[board.GlobalId].on == (wall.GlobalId,)
    assert found[bolt.GlobalId].on == (wall.GlobalId, post.GlobalId)
    assert not found[wall.GlobalId].on and not found[post.GlobalId].on
