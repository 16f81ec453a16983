"""The sample models: as committed, buildable, and the same in every schema."""

import itertools

import make_models
import numpy as np
import pytest
from building_models import box, building, element

from construction_twin.extensions.work.proposed_schedule import propose
from construction_twin.extensions.work.schedule import Schedule

MODELS = make_models.ROOT / "models"


def as_building(design):
    """A model of the design's boxes, as the reader would find it."""
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    elements = []
    for part in design.parts:
        x, y, z = np.array(part.size) / 1e3
        body = box((-x / 2, -y / 2, 0.0), (x / 2, y / 2, z))
        identifier = make_models.global_id(design.name, "element", part.name)
        rotation = turned if part.turned else None
        elements.append(element(identifier, body, at=np.array(part.at) / 1e3, rotation=rotation, name=part.name))
    return building(*elements, tasks=design.tasks, sequences=design.sequences)


def corners(one):
    points = one.bodies[0].vertices @ one.model_T_element.rotation.T + one.model_T_element.position
    return points.min(axis=0), points.max(axis=0)


@pytest.mark.parametrize("name", make_models.DESIGNS)
def test_the_committed_file_is_what_the_script_writes(name, tmp_path):
    make_models.build(name).write(str(tmp_path / "fresh.ifc"))
    assert (tmp_path / "fresh.ifc").read_bytes() == (MODELS / f"{name}.ifc").read_bytes()


@pytest.mark.parametrize(
    ("name", "count", "size"), [("timber_panel", 14, (2.4, 1.2, 0.135)), ("brick_wall", 40, (2.49, 0.115, 0.355))]
)
def test_elements_fill_the_outside_and_keep_their_joints(name, count, size):
    boxes = [corners(one) for one in as_building(make_models.DESIGNS[name]()).elements.values()]
    assert len(boxes) == count
    np.testing.assert_allclose(np.min([low for low, _ in boxes], axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.max([high for _, high in boxes], axis=0), size, atol=1e-9)
    for (low, high), (other_low, other_high) in itertools.combinations(boxes, 2):
        gaps = np.maximum(low - other_high, other_low - high)
        assert gaps.max() >= 0.002 - 1e-9 or abs(gaps[2]) < 1e-9, "a joint beside, or lying on one another"


@pytest.mark.parametrize("name", make_models.DESIGNS)
def test_the_schedule_makes_every_element_once_supports_first(name):
    model = as_building(make_models.DESIGNS[name]())
    schedule = Schedule.of(model)
    assert schedule.notes == () and len(schedule.jobs) == len(model.elements)
    assert all(job.robots == ("kr120",) for job in schedule.jobs)
    place = {job.element: number for number, job in enumerate(schedule.jobs)}
    proposal = propose(model)
    element_of = {task.id: task.products[0] for task in proposal.tasks.values() if task.products}
    assert proposal.notes == model.notes
    for one in proposal.sequences:
        assert place[element_of[one.before]] < place[element_of[one.after]]


@pytest.mark.parametrize("name", make_models.DESIGNS)
@pytest.mark.parametrize("schema", make_models.SCHEMAS)
def test_both_are_written_in_every_schema_with_weights_types_and_robot(name, schema):
    file = make_models.build(name, schema)
    design = make_models.DESIGNS[name]()
    assert file.schema == schema
    assert [task.Name for task in file.by_type("IfcTask")] == [task.name for task in design.tasks]
    assert [one.Name for one in file.by_type("IfcConstructionEquipmentResource")] == ["kr120"]
    weights = [quantity.WeightValue for quantity in file.by_type("IfcQuantityWeight")]
    assert len(weights) == len(design.parts) and 0.0 < max(weights) < 60.0
    makers = {relation.RelatingProduct.Name for relation in file.by_type("IfcRelAssignsToProduct")}
    assert makers == {part.name for part in design.parts}
    typed = {one.Name for relation in file.by_type("IfcRelDefinesByType") for one in relation.RelatedObjects}
    assert typed == makers
