"""The samples, laid by the package's own work plans: elements of earlier tasks have mass, and stay where they stand."""

from __future__ import annotations

from dataclasses import replace

import pytest
import work_samples
from physics_samples import plan_of

from construction_twin.extensions.physics.process import RehearsalRequest, rehearse
from construction_twin.extensions.work.ifc.reading import read_building
from construction_twin.extensions.work.process import TaskMotions
from construction_twin.extensions.work.work_cell import read_work_cell
from construction_twin.planning.work_plan import joined
from construction_twin.review.rehearsal_report import PASSED
from construction_twin.robot.segments import Segment

ROOT = work_samples.ROOT
CONFIG = ROOT / "config"


@pytest.fixture(scope="module", params=[("brick_wall", 20), ("timber_panel", 13)], ids=lambda param: param[0])
def laid(request) -> tuple[tuple[str, ...], TaskMotions]:
    """The elements of a sample that lie, and the motions that lay the next one on them."""
    name, count = request.param
    model = read_building(ROOT / f"models/{name}.ifc")
    elements = [one for one in model.elements.values() if one.bodies]
    layout = work_samples.layout(read_work_cell(CONFIG / f"work/{name}.yaml"), work_samples.building(*elements))
    lying, own = layout.order[:count], layout.order[count]
    scene = layout.scene({one: layout.base_T_goal(one) for one in lying})
    job = layout.job_for(own, scene)
    return lying, work_samples.planner().plan(job, work_samples.robot().home, scene)


def question(laid, standing: tuple[str, ...], unweighed: tuple[str, ...] = ()) -> RehearsalRequest:
    lying, motions = laid
    whole, ends = joined([segment.trajectory for segment in motions.segments])
    segments = tuple(
        Segment(segment.name, float(end), segment.engaged, (), (), before.hash, after.hash)
        for segment, end, before, after in zip(motions.segments, ends, motions.scenes, motions.scenes[1:])
    )
    masses = {"tool": work_samples.tool().tool.mass} | {one: 3.5 for one in (*lying, motions.job.element.id)}
    scenes = {scene.hash: scene for scene in motions.scenes}
    return RehearsalRequest(plan_of(whole, motions.scenes[0], segments), scenes, masses, "i", standing, unweighed)


ARM = {
    "robot": work_samples.robot(), "self_collision": str(CONFIG / "kr120_track_self_collision.yaml"),
    "drives": str(CONFIG / "kr120_track_drives.yaml"), "tool": str(work_samples.TOOL),
}  # fmt: skip


def test_the_next_element_is_laid_and_no_other_moves(laid):
    lying, motions = laid
    asked = question(laid, lying)
    report = rehearse(ARM, asked)
    assert (report.state, report.reasons) == (PASSED, ())
    (own,) = report.objects
    assert own.name == motions.job.element.id and own.moved < 0.001 and own.resting
    assert not any("fixed in this rehearsal" in remark for remark in report.remarks)
    assert repr(replace(rehearse(ARM, asked), took=0.0, settle_took=0.0)) == repr(
        replace(report, took=0.0, settle_took=0.0)
    )


def test_elements_without_a_known_mass_is_fixed_and_named(laid):
    lying, _ = laid
    report = rehearse(ARM, question(laid, (), lying))
    (remark,) = [each for each in report.remarks if "fixed in this rehearsal" in each]
    assert report.state == PASSED and "their masses are unknown" in remark
    assert all(one in remark for one in lying)
