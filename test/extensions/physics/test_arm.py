from dataclasses import replace

import coal
import mujoco
import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from physics_samples import READY, between, bodies_of, drives, dynamics_of, model_of, robot_of

from construction_twin.core.units import CYCLE
from construction_twin.extensions.physics.arm import Servo, SimulatedArm
from construction_twin.extensions.physics.mass import of_shape
from construction_twin.extensions.physics.model import Load
from construction_twin.mock.servo import RealisticServo

FAR = READY + np.array((1.0, 0.3, -0.4, 0.8, -0.6, 1.2))


def cycles(duration: float) -> np.ndarray:
    return np.arange(round(duration / CYCLE) + 1) * CYCLE


def test_with_setpoints_that_are_held_it_is_the_mock_s_servo():
    motion = between(READY, FAR, 2.0)
    arm, servo = SimulatedArm(model_of(), READY, Servo(holds=True)), RealisticServo(resolution=0.0)
    servo.reset(READY)
    for setpoint in motion.sample_many(cycles(2.0))[0]:
        arm.cycle(setpoint)
        np.testing.assert_allclose(arm.q, servo.step(setpoint.tolist()), atol=5e-5)


@pytest.mark.parametrize("name", ["kr120", "kr120_track", "ur_like"])
def test_the_torque_of_a_motion_is_that_of_pinocchio_s_inverse_dynamics(name):
    robot = robot_of(name)
    start = READY if name == "kr120" else np.array(robot.home)
    goal = start + 0.3
    motion = between(start, goal, 1.5, name)
    physics = model_of(name)
    arm = SimulatedArm(physics, start, Servo(saturates=False))
    model, order = dynamics_of(name)
    data = model.createData()
    found, expected, path = [], [], []
    for setpoint in motion.sample_many(cycles(1.5))[0]:
        path.append(arm.q)
        for _step in arm.steps(setpoint):
            found.append(arm.needed)
            path.append(arm.q)
        path.pop()
    # the motion itself, differentiated twice from where the arm has been
    speed = np.gradient(path, 0.001, axis=0)
    acceleration = np.gradient(speed, 0.001, axis=0)
    for q, qd, qdd in zip(path, speed, acceleration):
        row, rate, change = np.zeros((3, bodies_of(name).size))
        row[order], rate[order], change[order] = q, qd, qdd
        expected.append(pinocchio.rnea(model, data, row, rate, change)[order])
    difference = np.array(found)[5:-5] - np.array(expected)[5:-5]
    scale = np.sqrt(np.mean(np.array(expected) ** 2))
    assert np.sqrt(np.mean(difference**2)) < 0.01 * scale


def test_friction_damping_and_the_motors_inertia_cost_what_the_file_says():
    plain = replace(drives(), armature=(0.0,) * 6, damping=(0.0,) * 6, friction=(0.0,) * 6)
    rough = replace(plain, friction=(200.0,) * 6, damping=(100.0,) * 6, armature=(50.0,) * 6)
    motion = between(READY, FAR, 2.0)
    needed = []
    for each in (plain, rough):
        arm = SimulatedArm(model_of(of=each), READY)
        setpoints = motion.sample_many(cycles(1.0))[0]
        for setpoint in setpoints:
            arm.cycle(setpoint)
        # in the middle nothing accelerates, and it is at its fastest
        needed.append(arm.needed)
        assert np.abs(arm.q - arm.answer).max() < 1e-3
    speed = arm.data.qvel[arm.physics.joints]
    acceleration = motion.sample(1.0 - 0.029)[2]
    expected = 200.0 * np.sign(speed) + 100.0 * speed + 50.0 * acceleration
    np.testing.assert_allclose(needed[1] - needed[0], expected, atol=5.0)


def test_an_axis_gives_no_more_than_it_has():
    weak = replace(drives(), torque=(100.0,) * 6)
    arm = SimulatedArm(model_of(of=weak), READY)
    for setpoint in between(READY, FAR, 1.0).sample_many(cycles(0.5))[0]:
        arm.cycle(setpoint)
        assert np.abs(arm.torque).max() <= 100.0
    assert np.abs(arm.needed).max() > 100.0
    strong = SimulatedArm(model_of(of=weak), READY, Servo(saturates=False))
    for setpoint in between(READY, FAR, 1.0).sample_many(cycles(0.5))[0]:
        strong.cycle(setpoint)
    assert np.abs(strong.q - strong.answer).max() < 1e-3


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=10)
def test_the_arm_holds_every_load_that_it_is_rated_for_where_it_stands(seed):
    rng = np.random.default_rng(seed)
    load = of_shape(coal.Box(0.3, 0.3, 0.3)).scaled_to(rng.uniform(1.0, 120.0))
    robot = robot_of("kr120")
    q = rng.uniform(np.maximum(robot.lower, -1.0), np.minimum(robot.upper, 1.5))
    arm = SimulatedArm(model_of(load=Load(flange=load), of=drives()), q)
    arm.physics.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    for _ in range(50):
        arm.cycle(q)
    np.testing.assert_allclose(arm.q, q, atol=1e-6)
