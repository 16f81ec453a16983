"""One task as a plan: its parts, its scenes, what may touch, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from work_samples import brick_recipe, building, element, layout, pairs, planner, robot, tool, work_cell

from construction_twin.core.units import CYCLE
from construction_twin.extensions.work.contacts import ShapeDistances
from construction_twin.extensions.work.layout import Layout
from construction_twin.extensions.work.process import TaskMotions, TaskPlanningError
from construction_twin.kinematics.chain import Pose
from construction_twin.planning.limit_usage import cycle_times
from construction_twin.planning.planner import PlanRequest
from construction_twin.planning.request_limits import PlanBounds
from construction_twin.planning.work_plan import plan_work
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject, product, tool_objects
from construction_twin.scene.scene_change import SceneChange

HOME = np.array(robot().home)


@pytest.fixture(scope="module")
def work(tmp_path_factory) -> Layout:
    return layout(work_cell(tmp_path_factory.mktemp("cell")), building())


@pytest.fixture(scope="module")
def plans(work) -> list[TaskMotions]:
    """The three bricks, one after the other."""
    made, placed, q = [], {}, HOME
    for brick in work.order:
        scene = work.scene(placed)
        made.append(planner().plan(work.job_for(brick, scene), q, scene))
        q = made[-1].segments[-1].trajectory.positions[-1]
        placed[brick] = work.base_T_goal(brick)
    return made


def parts(plan):
    return {segment.name: segment for segment in plan.segments}


def scenes(plan):
    return {segment.name: scene for segment, scene in zip(plan.segments, plan.scenes)}


def test_a_task_has_six_parts_that_join_at_rest_on_whole_cycles(plans):
    before = HOME
    for plan in plans:
        assert [segment.name for segment in plan.segments] == [
            "to stock", "approach", "lift", "carry", "set down", "retreat"
        ]  # fmt: skip
        for segment in plan.segments:
            motion = segment.trajectory
            assert np.array_equal(motion.positions[0], before)
            before = motion.positions[-1]
            assert not motion.velocities[[0, -1]].any() and not motion.accelerations[[0, -1]].any()
            assert motion.duration / CYCLE == pytest.approx(round(motion.duration / CYCLE), abs=1e-6)
        assert plan.planning_time > 0.0 and plan.clearance > 0.02


def test_the_tool_is_switched_where_it_touches_and_asked_while_it_carries(plans):
    for plan in plans:
        found = parts(plan)
        assert [s.engaged for s in plan.segments] == [False, True, True, False, True, True]
        assert [[(w.output, w.value) for w in s.switches] for s in plan.segments] == [
            [], [("vacuum", True)], [], [], [("vacuum", False)], []
        ]  # fmt: skip
        held = {"lift", "carry", "set down"}
        for name, segment in found.items():
            assert [(s.name, s.value) for s in segment.requires] == [("vacuum_reached", name in held)]


def test_a_carry_is_engaged_when_the_recipe_says_so(work):
    scene = work.scene()
    job = work.job_for("brick0", scene)
    assert parts(planner(brick_recipe(carry_engaged=True)).plan(job, HOME, scene))["carry"].engaged


def test_each_scene_follows_from_the_one_before_as_the_scene_node_changes_it(plans, work):
    placed = {}
    for plan, brick in zip(plans, work.order):
        scene = work.scene(placed)
        assert plan.scenes[0].hash == scene.hash
        for segment, after in zip(plan.segments, plan.scenes[1:], strict=True):
            scene = segment.change.apply(scene)
            assert after.hash == scene.hash
        placed[brick] = work.base_T_goal(brick)
        assert scene.hash == work.scene(placed).hash


def test_only_what_has_to_touch_may_touch(plans):
    bare = {item.name: item.touch for item in tool_objects(tool(), robot().tip_link)}
    for plan in plans:
        own = {item.name for item in plan.job.bodies}
        for segment, scene in zip(plan.segments, plan.scenes):
            for item in scene.objects:
                extra = set(item.touch) - set(bare.get(item.name, ()))
                if item.name == "tool/cups":
                    assert extra == (own if segment.name in ("approach", "retreat") else set())
                elif item.name in own:
                    allowed = {"lift": {"rack"}, "set down": set(plan.job.supports) - {"rack"}}.get(segment.name, set())
                    assert extra == allowed
                else:
                    assert not extra


def test_what_may_touch_does_not_go_into_each_other(plans):
    for plan in plans:
        for segment, scene in zip(plan.segments, plan.scenes):
            world = CollisionWorld(robot(), scene, pairs())
            qs = segment.trajectory.sample_many(cycle_times(segment.trajectory))[0]
            assert world.all_free(qs) is None
            touching = world.touching_world()
            found = None if touching is None else touching.clearance_of(qs)
            if segment.name in ("carry", "to stock"):
                # the tool may touch the flange, which moves with it
                assert found is None
            else:
                assert -5e-4 < found[0].distance < 1e-3


def test_the_element_arrives_where_it_is_to_stand(plans):
    for plan in plans:
        q = parts(plan)["set down"].trajectory.positions[-1]
        world = CollisionWorld(robot(), scenes(plan)["set down"], pairs())
        (body,) = plan.job.bodies
        there = world.object_pose(q, body.name)
        goal = product(plan.job.base_T_goal, body.pose)
        assert np.linalg.norm(there.position - goal.position) < 2e-4
        tip = world.link_pose(q, robot().tip_link)
        assert np.allclose(product(tip, plan.tool0_T_element).position, plan.job.base_T_goal.position, atol=2e-4)


def test_the_same_task_gives_the_same_plan(work, plans):
    scene = work.scene()
    again = planner().plan(work.job_for("brick0", scene), HOME, scene)
    assert [s.trajectory.content_hash() for s in again.segments] == [
        s.trajectory.content_hash() for s in plans[0].segments
    ]


def test_a_task_goes_on_with_the_element_in_the_grip(work, plans):
    there, q = scenes(plans[0])["carry"], parts(plans[0])["lift"].trajectory.positions[-1]
    rest = planner().plan(plans[0].job, q, there, held=plans[0].tool0_T_element)
    assert [segment.name for segment in rest.segments] == ["carry", "set down", "retreat"]
    assert rest.scenes[0].hash == there.hash
    assert rest.scenes[-1].hash == plans[0].scenes[-1].hash


def with_object(scene: Scene, name: str, size, position) -> Scene:
    return scene.add(SceneObject(name, "box", size, position))


def test_what_is_no_support_keeps_the_padding_at_the_goal_too(work):
    goal = work.base_T_goal("brick0").position
    fence = with_object(work.scene(), "fence", (0.02, 0.2, 0.05), (goal[0] - 0.145, goal[1], 0.625))
    job = work.job_for("brick0", fence)
    with pytest.raises(TaskPlanningError, match="would touch fence") as caught:
        planner().plan(job, HOME, fence)
    assert caught.value.stage == "set down" and caught.value.method and caught.value.task == "brick0"
    # the same 15 mm away, but named
    assert planner().plan(replace(job, supports=(*job.supports, "fence")), HOME, fence)


@pytest.mark.parametrize(("deep", "allowed"), [(0.0003, True), (0.002, False)])
def test_a_support_is_touched_but_not_entered(work, deep, allowed):
    goal = work.base_T_goal("brick0").position
    plate = with_object(work.scene(), "plate", (0.3, 0.2, 0.02), (goal[0], goal[1], 0.6 - 0.01 + deep))
    job = replace(work.job_for("brick0", plate), supports=("plate", "rack", "table"))
    if allowed:
        assert planner().plan(job, HOME, plate)
        return
    with pytest.raises(
        TaskPlanningError, match=r"brick0/0 would be 2.0 mm inside of plate; at most 0.5 mm are allowed"
    ):
        planner().plan(job, HOME, plate)


def test_the_tools_other_shapes_keep_the_padding_to_a_neighbour(tmp_path):
    """A neighbour that is higher than the element by more than the cups' height is in the way of the frame."""
    model = building(
        element("low", (0, 0, 0)), element("high", (0, 0.14, 0), (0.24, 0.115, 0.15), type_name="240x115x71 x2")
    )
    found = layout(work_cell(tmp_path), model)
    scene = found.scene({"high": found.base_T_goal("high")})
    with pytest.raises(TaskPlanningError, match="tool/frame would touch high/0"):
        planner().plan(found.job_for("low", scene), HOME, scene)


def test_a_tool_beside_a_neighbour_needs_the_recipes_word(tmp_path):
    model = building(*(element(f"b{number}", (0.25 * number, 0, 0)) for number in range(3)))
    found = layout(work_cell(tmp_path), model)
    both = {"b0": found.base_T_goal("b0"), "b2": found.base_T_goal("b2")}
    scene = found.scene(both)
    job = found.job_for("b1", scene)
    with pytest.raises(TaskPlanningError, match="tool/cups would touch"):
        planner().plan(job, HOME, scene)
    plan = planner(brick_recipe("grips", beside=("cups",))).plan(job, HOME, scene)
    cups = scenes(plan)["set down"].get("tool/cups")
    assert {"b0/0", "b2/0"} & set(cups.touch) and "floor" not in cups.touch
    assert scenes(plan)["carry"].get("tool/cups").touch == ("link_6",)


def test_a_symmetric_element_may_be_turned_and_stands_as_designed(work, plans):
    turned = brick_recipe("grips", turns_deg=(180.0,))
    scene = work.scene()
    plan = planner(turned).plan(work.job_for("brick0", scene), HOME, scene)
    assert "element turned 180 deg" in plan.method
    assert plan.scenes[-1].hash == plans[0].scenes[-1].hash
    # and whoever checks it for review takes it, though the element's frame counts as turned from the grip on
    world = CollisionWorld(robot(), scene, pairs())
    checked = plan_work("brick0", plan.segments, HOME, PlanRequest("test", 0), world, PlanBounds(), lambda: 0.0)
    assert [part.scene_after for part in checked.segments] == [scene.hash for scene in plan.scenes[1:]]


def test_out_of_reach_is_told_with_the_part(work):
    scene = work.scene()
    far = Pose(np.array([0.0, 5.0, 0.6]), np.eye(3))
    with pytest.raises(TaskPlanningError, match="letting go") as caught:
        planner().plan(replace(work.job_for("brick0", scene), base_T_goal=far), HOME, scene)
    assert caught.value.stage == "reach"


def test_a_budget_ends_the_search_and_says_so(work):
    scene = work.scene()
    far = Pose(np.array([0.0, 3.6, 0.6]), np.eye(3))
    with pytest.raises(TaskPlanningError, match=r"\(1 of .* grips tried in 0 s\)"):
        planner(budget=0.0).plan(replace(work.job_for("brick0", scene), base_T_goal=far), HOME, scene)


def test_an_arm_in_contact_is_not_planned_from(work):
    scene = with_object(work.scene(), "block", (0.3, 0.3, 0.3), tuple(np.array([HOME[0] + 1.35, 0.0, 1.9])))
    with pytest.raises(TaskPlanningError, match="touches .* or is closer than the padding"):
        planner().plan(work.job_for("brick0", scene), HOME, scene)


# -- what would fall


@pytest.mark.parametrize("fastened", [False, True])
def test_an_element_that_nothing_is_under_is_refused_unless_it_is_fastened(tmp_path, fastened):
    above = layout(work_cell(tmp_path), building(element("tile", (0.0, 0.0, 0.25))))
    scene = above.scene()
    job = above.job_for("tile", scene)
    if fastened:
        found = planner(brick_recipe("place", fastened=True)).plan(job, HOME, scene)
        assert found.segments[-1].name == "retreat"
        return
    with pytest.raises(TaskPlanningError, match="nothing holds tile when the tool lets go") as caught:
        planner().plan(job, HOME, scene)
    assert caught.value.stage == "set down"


def test_an_element_in_the_grip_is_not_let_go_in_mid_air_either(tmp_path):
    above = layout(work_cell(tmp_path), building(element("tile", (0.0, 0.0, 0.25))))
    scene = above.scene()
    job = above.job_for("tile", scene)
    held = Pose(np.array([0.0, 0.0, 0.3]), np.eye(3))
    carried = SceneChange(tuple(item.moved(product(held, item.pose), robot().tip_link) for item in job.bodies))
    with pytest.raises(TaskPlanningError, match="nothing holds tile when the tool lets go"):
        planner().plan(job, HOME, carried.apply(scene), held=held)


BOX = SceneObject("box", "box", (0.2, 0.2, 0.1))
UP = np.array([0.0, 0.0, 1.0])
ALIKE = Pose(np.array([0.0, 0.0, 1.05]), np.eye(3))


@pytest.mark.parametrize(
    ("position", "holds"),
    [
        ((0.0, 0.0, 0.95), True),
        ((0.19, 0.0, 0.95), True),
        ((0.0, 0.0, 0.938), True),
        ((0.0, 0.0, 0.955), True),
        ((0.0, 0.0, 0.92), False),
        ((0.2, 0.0, 1.05), False),
        ((0.199, 0.0, 1.05), False),
        ((0.205, 0.0, 0.95), False),
        ((0.0, 0.0, 1.15), False),
    ],
    ids=["below", "below its edge", "a mortar bed", "5 mm inside", "too low", "beside", "pressed in", "past", "above"],
)
def test_only_what_is_under_an_element_holds_it(position, holds):
    other = replace(BOX, name="other", position=position)
    assert ShapeDistances().support_below([BOX], ALIKE, [other], UP) == ("other" if holds else "")


def test_what_is_under_is_so_by_gravity_and_not_by_the_base():
    wall = replace(BOX, name="wall", position=(-0.2, 0.0, 1.05))
    assert ShapeDistances().support_below([BOX], ALIKE, [wall], UP) == ""
    assert ShapeDistances().support_below([BOX], ALIKE, [wall], np.array([1.0, 0.0, 0.0])) == "wall"
