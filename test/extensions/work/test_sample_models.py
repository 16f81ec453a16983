"""The sample models: their elements keep their joints, and their schedules can be built."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from processes import ROOT

from construction_twin.extensions.work.ifc.reading import read_building
from construction_twin.extensions.work.schedule import Schedule, propose


@pytest.fixture(scope="module", params=["timber_panel", "brick_wall"])
def model(request):
    return read_building(ROOT / f"models/{request.param}.ifc")


def corners(one):
    points = one.bodies[0].vertices @ one.model_T_element.rotation.T + one.model_T_element.position
    return points.min(axis=0), points.max(axis=0)


def test_elements_fill_the_outside_and_keep_their_joints(model):
    count, size = {"timber_panel": (14, (2.4, 1.2, 0.135)), "brick_wall": (40, (2.49, 0.115, 0.355))}[model.project]
    boxes = [corners(one) for one in model.elements.values() if one.bodies]
    assert len(boxes) == count
    np.testing.assert_allclose(np.min([low for low, _ in boxes], axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.max([high for _, high in boxes], axis=0), size, atol=1e-9)
    for (low, high), (other_low, other_high) in itertools.combinations(boxes, 2):
        gaps = np.maximum(low - other_high, other_low - high)
        assert gaps.max() >= 0.002 - 1e-9 or abs(gaps[2]) < 1e-9, "a joint beside, or lying on one another"


def test_the_schedule_makes_every_element_once_supports_first(model):
    schedule = Schedule.of(model)
    assert schedule.notes == () and len(schedule.jobs) == sum(bool(one.bodies) for one in model.elements.values())
    assert all(job.robots == ("kr120",) for job in schedule.jobs)
    assert 0.0 < max(one.mass for one in model.elements.values() if one.bodies) < 60.0
    place = {job.element: number for number, job in enumerate(schedule.jobs)}
    proposal = propose(model)
    element_of = {task.id: task.products[0] for task in proposal.tasks.values() if task.products}
    assert proposal.notes == model.notes
    for one in proposal.sequences:
        assert place[element_of[one.before]] < place[element_of[one.after]]
