"""An order from the geometry: supports first, then from below, then as in the file."""

import numpy as np
import pytest
from building_models import box, building, element
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.extensions.work.building import ScheduleError
from construction_twin.extensions.work.schedule import Schedule, propose


def order(model):
    return [job.element for job in Schedule.of(propose(model), proposed=True).jobs]


def waits(model):
    """What each element waits for, directly."""
    proposal = propose(model)
    element_of = {task.id: task.products[0] for task in proposal.tasks.values() if task.products}
    return {(element_of[one.before], element_of[one.after]) for one in proposal.sequences}


@pytest.mark.parametrize("gap", [-0.004, 0.0, 0.001, 0.005])
def test_what_carries_comes_first_across_a_small_gap(gap):
    model = building(
        element("top", box((0, 0, 1 + gap), (1, 1, 2))),
        element("bottom", box((0, 0, 0), (1, 1, 1))),
    )
    assert order(model) == ["bottom", "top"] and waits(model) == {("bottom", "top")}


def test_a_noggin_comes_after_the_studs_that_begin_lower():
    model = building(
        element("noggin", box((0.062, 0, 1.0), (0.538, 0.12, 1.06))),
        element("top", box((0, 0, 2.06), (0.6, 0.12, 2.12))),
        element("left", box((0, 0, 0.06), (0.06, 0.12, 2.06))),
        element("right", box((0.54, 0, 0.06), (0.6, 0.12, 2.06))),
        element("bottom", box((0, 0, 0), (0.6, 0.12, 0.06))),
    )
    assert order(model) == ["bottom", "left", "right", "noggin", "top"]
    assert {("left", "top"), ("right", "top")} <= waits(model)


def test_a_rafter_rests_on_its_purlin_though_both_boxes_overlap():
    angle = np.radians(30.0)
    turn = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    rafter = element("rafter", box((-2, -0.04, 0.001), (2, 0.04, 0.2)), rotation=turn)
    # its top follows the rafter's slope
    purlin = element("purlin", box((-0.05, -1, -0.2), (0.05, 1, 0.0)), rotation=turn)
    floor = element("floor", box((-3, -3, -3), (3, 3, -2.9)))
    assert ("purlin", "rafter") in waits(building(rafter, purlin, floor))


def test_elements_that_rest_on_each_other_are_refused():
    # two angles hooked into each other: each has a lip on the other's
    first = element("first", box((0, 0, 0), (1, 1, 1)), box((0, 0, 1), (0.3, 1, 2)))
    second = element("second", box((0.3, 0, 1.0), (1, 1, 2)), box((-1, 0, -1), (-0.01, 1, 0.5)))
    lip = element(
        "third", box((-1, 0, 0.5), (-0.01, 1, 0.9)), box((1.01, 0, 0), (2, 1, 1)), box((0.5, 0, 2), (2, 1, 3))
    )
    hook = element(
        "fourth", box((0.5, 0, 3), (2, 1, 4)), box((-1, 0, 0.9), (-0.2, 1, 1.2)), box((1.1, 0, -0.3), (2, 1, 0.0))
    )
    with pytest.raises(ScheduleError, match="rest on each other in a circle"):
        propose(building(first, second, lip, hook))


def test_what_has_no_geometry_gets_no_place_and_a_model_without_any_is_refused():
    assert order(building(element("solid", box((0, 0, 0), (1, 1, 1))), element("empty"))) == ["solid"]
    with pytest.raises(ScheduleError, match="no workpiece"):
        propose(building(element("empty")))


@settings(max_examples=30, deadline=None)
@given(st.permutations(range(12)), st.floats(-0.005, 0.005))
def test_a_wall_in_bond_comes_course_by_course_whatever_the_files_order(permutation, gap):
    bricks = []
    for course, count in enumerate((5, 4, 3)):
        for i in range(count):
            x, z = 0.25 * (i + course / 2), course * (0.071 + gap)
            bricks.append(element(f"{course}.{i}", box((x, 0, z), (x + 0.24, 0.115, z + 0.071))))
    found = waits(building(*(bricks[i] for i in permutation)))
    assert found == {(f"{c}.{i + k}", f"{c + 1}.{i}") for c, n in ((0, 4), (1, 3)) for i in range(n) for k in (0, 1)}
