import mujoco
import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from physics_samples import OTHERS, READY, bodies_of, dynamics_of, model_of, pairs_of, robot_of
from scene_samples import FLOOR, clutter, random_poses, write_stl

from construction_twin.extensions.physics.drive import drives_of
from construction_twin.extensions.physics.mass import GRAVITY
from construction_twin.extensions.physics.model import Load, build_model
from construction_twin.kinematics.chain import Chain
from construction_twin.robot.description import load_robot
from construction_twin.robot.new_robot import new_description
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import SelfCollision

ARMS = ("kr120", "kr120_track", *OTHERS, "ur_like_gripper", "endless_like")
#: Those of the URDFs that say what their links weigh.
WEIGHED = ("kr120", "kr120_track", "ur_like", "ur_like_gripper")
TABLE = SceneObject("table", "box", (1.0, 1.0, 0.6), (1.6, 0.0, 0.3))


@pytest.mark.parametrize("name", WEIGHED)
def test_gravity_and_masses_are_those_of_pinocchio(name):
    physics, (model, order) = model_of(name), dynamics_of(name)
    data, own = model.createData(), physics.at_rest(np.zeros(len(order)))
    gravity, inertia, product = [], [], np.zeros(physics.model.nv)
    for q in random_poses(robot_of(name), 1000):
        row = bodies_of(name).rows(q[None])[0]
        own.qpos[physics.joints] = q
        mujoco.mj_fwdPosition(physics.model, own)
        mujoco.mj_fwdVelocity(physics.model, own)
        mass = pinocchio.crba(model, data, row)
        mass = np.triu(mass) + np.triu(mass, 1).T
        direction = np.linspace(1.0, -1.0, len(order))
        whole = np.zeros(physics.model.nv)
        whole[physics.joints] = direction
        mujoco.mj_mulM(physics.model, own, product, whole)
        expected = mass[np.ix_(order, order)] @ direction
        inertia.append(np.abs(product[physics.joints] - expected).max() / np.abs(expected).max())
        torque = pinocchio.computeGeneralizedGravity(model, data, row)[order]
        gravity.append(np.abs(own.qfrc_bias[physics.joints] - torque).max())
        scale = max(np.abs(torque).max(), 1.0)
        gravity[-1] /= scale
    assert max(gravity) < 1e-6
    assert max(inertia) < 1e-6


@pytest.mark.parametrize("name", ARMS)
@given(data=st.data())
@settings(deadline=None, max_examples=50)
def test_the_flange_is_where_kdl_has_it(name, data):
    robot = robot_of(name)
    q = np.array([data.draw(st.floats(low, high)) for low, high in zip(robot.lower, robot.upper)])
    expected = Chain(robot).forward(q)
    bodies = bodies_of(name)
    frame = bodies.model.frames[bodies.model.getFrameId(robot.tip_link, pinocchio.FrameType.BODY)]
    found = model_of(name).at_rest(q).body(f"joint\n{bodies.model.names[frame.parentJoint]}")
    root_T_tip = pinocchio.SE3(found.xmat.reshape(3, 3), found.xpos) * frame.placement
    base_T_tip = bodies.root_T_base.actInv(root_T_tip)
    np.testing.assert_allclose(base_T_tip.translation, expected.position, atol=1e-9)
    np.testing.assert_allclose(base_T_tip.rotation, expected.rotation, atol=1e-9)


def test_a_block_at_rest_presses_with_its_weight():
    block = SceneObject("block", "box", (0.2, 0.2, 0.2), (1.6, 0.0, 0.7))
    physics = model_of(scene=Scene((TABLE, block)), load=Load({"block": 12.0}, {"block": "block"}))
    data = physics.at_rest(READY)
    for _ in range(1000):
        data.qfrc_applied[physics.joints] = data.qfrc_bias[physics.joints]
        mujoco.mj_step(physics.model, data)
    pressed, force = 0.0, np.zeros(6)
    for number in range(data.ncon):
        if {physics.owners[geom] for geom in data.contact.geom[number]} == {"table", "block"}:
            mujoco.mj_contactForce(physics.model, data, number, force)
            pressed += force[0]
    assert pressed == pytest.approx(12.0 * GRAVITY, rel=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_what_the_planner_calls_free_touches_nothing(seed):
    scene = clutter(seed)
    world = CollisionWorld(robot_of("kr120"), scene, pairs_of("kr120"))
    physics = model_of(scene=scene)
    free = [q for q in random_poses(robot_of("kr120"), 400, seed) if world.is_free(q)]
    assert len(free) > 20
    for q in free:
        data = physics.at_rest(q)
        touching = [tuple(geoms) for geoms in data.contact.geom if physics.unplanned[tuple(geoms)]]
        assert touching == []


def test_what_the_planner_calls_a_contact_touches_here_too():
    scene = Scene((FLOOR, TABLE))
    world = CollisionWorld(robot_of("kr120"), scene, pairs_of("kr120"))
    physics = model_of(scene=scene)
    seen = 0
    for q in random_poses(robot_of("kr120"), 200):
        deep = {frozenset(pair.between) for pair in world.distances(q) if pair.distance < -0.01}
        data = physics.at_rest(q)
        found = {frozenset(physics.owners[geom] for geom in geoms) for geoms in data.contact.geom}
        seen += len(deep)
        assert deep <= found
    assert seen > 20


def corner_mesh(path, closed: bool = True) -> str:
    """Write an L of two boxes, which is not convex, and return its path; not closed: a triangle is missing at its end."""
    triangles = []
    outline = [(0.0, 0.0), (0.4, 0.0), (0.4, 0.1), (0.1, 0.1), (0.1, 0.4), (0.0, 0.4)]
    for low, high in zip(outline, outline[1:] + outline[:1]):
        a, b = (*low, 0.0), (*high, 0.0)
        c, d = (*high, 0.1), (*low, 0.1)
        triangles += [(a, b, c), (a, c, d)]
    for one, two, three in ((0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)):
        triangles.append([(*outline[corner], 0.1) for corner in (one, two, three)])
        triangles.append([(*outline[corner], 0.0) for corner in (three, two, one)])
    return write_stl(path, np.array(triangles if closed else triangles[:-1]))


def test_a_mesh_that_cannot_be_divided_is_its_hull_and_says_so(tmp_path):
    corner = SceneObject("corner", "mesh", (), (1.5, 0.0, 1.0), mesh=corner_mesh(tmp_path / "l.stl", closed=False))
    physics = model_of(scene=Scene((corner,)))
    (remark,) = [remark for remark in physics.remarks if "the mesh of" in remark]
    assert "the mesh of corner is neither convex nor closed" in remark
    # of the bodies that can be moved the mass is that of the mesh, not of the hull
    whole = SceneObject("corner", "mesh", (), (1.5, 0.0, 1.0), mesh=corner_mesh(tmp_path / "whole.stl"))
    loose = model_of(scene=Scene((whole,)), load=Load({}, {"corner": "corner"}))
    assert loose.model.body("corner").mass[0] == pytest.approx(1000.0 * (0.4 * 0.1 + 0.3 * 0.1) * 0.1, rel=1e-6)
    # a probe in the notch, where only the hull is
    probe = SceneObject("probe", "sphere", (0.03,), (1.65, 0.15, 1.05))
    beside = model_of(scene=Scene((corner, probe)), load=Load({"probe": 1.0}, {"probe": "probe"}))
    owners = [{beside.owners[geom] for geom in geoms} for geoms in beside.at_rest(READY).contact.geom]
    assert {"corner", "probe"} in owners


def test_a_link_that_is_not_convex_is_pieces_in_the_simulation_and_says_so(tmp_path):
    """The planner keeps its surface; its hull would touch what lies in its notch."""
    mesh = corner_mesh(tmp_path / "l.stl")
    shape = f'<geometry><mesh filename="file://{mesh}"/></geometry>'
    urdf = (
        f'<robot name="one"><link name="base_link"/><link name="arm"><collision>{shape}</collision></link><link name="tool0"/>'
        '<joint name="j" type="revolute"><parent link="base_link"/><child link="arm"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="100"/></joint><joint name="f" type="fixed">'
        '<parent link="arm"/><child link="tool0"/><origin xyz="0 0 -0.2"/></joint></robot>'
    )
    robot = load_robot(urdf, new_description(urdf, "one", "base_link", "tool0", 1.0))
    bodies, none = RobotBodies(robot), SelfCollision({}, "")
    for gap, free in ((0.03, True), (-0.005, False)):
        probe = SceneObject("probe", "sphere", (0.03,), (0.13 + gap, 0.2, 0.05))
        scene = Scene((probe,))
        physics = build_model(bodies, scene, none, drives_of(robot))
        (remark,) = [remark for remark in physics.remarks if "the mesh of" in remark]
        assert "arm is not convex" in remark and "reach up to 0.0 mm" in remark
        owners = [{physics.owners[geom] for geom in geoms} for geoms in physics.at_rest([0.0]).contact.geom]
        assert ({"arm", "probe"} not in owners) is free
        assert CollisionWorld(robot, scene, none).is_free([0.0]) is free
