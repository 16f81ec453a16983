"""What the plugin for Gazebo calculates (gazebo/arm_control.hpp), compiled without Gazebo, against Pinocchio, Python and MuJoCo."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from physics_samples import OTHERS, READY, ROOT, between, bodies_of, drives, dynamics_of, model_of

from construction_twin.core.units import CYCLE
from construction_twin.extensions.physics.arm import Servo, SimulatedArm
from construction_twin.extensions.physics.nodes.gazebo import world_of
from construction_twin.mock.servo import RealisticServo
from construction_twin.scene.objects import Scene
from construction_twin.servo.model import transition_matrix

ARMS = ("kr120", "kr120_track", *OTHERS)
FAR = READY + np.array((1.0, 0.3, -0.4, 0.8, -0.6, 1.2))


@cache
def chain_of(name: str) -> str:
    sdf = ElementTree.fromstring(world_of(bodies_of(name), Scene(), drives(name), Path("/none")).sdf)
    return sdf.findtext(".//plugin/chain", "")


class Maths:
    """The compiled header, asked line by line."""

    def __init__(self, program: Path, chain: Path):
        self._process = subprocess.Popen([program, chain], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ask(self, word: str, *values: Sequence[float]) -> np.ndarray:
        numbers = " ".join(repr(float(one)) for each in values for one in np.atleast_1d(each))
        print(word, numbers, file=self._process.stdin, flush=True)
        return np.array(self._process.stdout.readline().split(), dtype=float)

    def close(self) -> None:
        self._process.stdin.close()
        assert self._process.wait(10.0) == 0
        self._process.stdout.close()


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("gazebo") / "check"
    source = ROOT / "test/support/arm_control_check.cpp"
    subprocess.run(["g++", "-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", source, "-o", made], check=True)
    return made


@pytest.fixture(scope="module")
def maths(program, tmp_path_factory) -> Iterator:
    opened: dict[str, Maths] = {}

    def of(name: str) -> Maths:
        if name not in opened:
            chain = tmp_path_factory.mktemp("chain") / name
            chain.write_text(chain_of(name))
            opened[name] = Maths(program, chain)
        return opened[name]

    yield of
    for one in opened.values():
        one.close()


@given(omega=st.floats(0.1, 500.0), zeta=st.one_of(st.just(1.0), st.floats(0.05, 3.0)), period=st.floats(1e-4, 0.02))
def test_the_lag_is_that_of_servo_lag(maths, omega, zeta, period):
    found = maths("kr120").ask("lag", omega, zeta, period)
    np.testing.assert_allclose(found, np.ravel(transition_matrix(omega, zeta, period)), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_inverse_dynamics_are_pinocchio_s(maths, name, seed):
    model, order = dynamics_of(name)
    values = np.random.default_rng(seed)
    q, speed, acceleration = values.uniform(-3.0, 3.0, (3, len(order)))
    given = np.zeros((3, model.nq))
    given[:, order] = q, speed, acceleration
    # a link of which the URDF says no mass has an estimate in the world, and none for Pinocchio
    mine = model.copy()
    for index, line in enumerate(chain_of(name).split("\n")[2:-1], start=1):
        numbers = np.array(line.split()[2:], dtype=float)
        xx, yy, zz, xy, xz, yz = numbers[19:25]
        moments = np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
        mine.inertias[index] = pinocchio.Inertia(numbers[15], numbers[16:19], moments)
    if name in ("kr120", "kr120_track", "ur_like"):
        assert sum(one.mass for one in mine.inertias) == pytest.approx(sum(one.mass for one in model.inertias))
    expected = pinocchio.rnea(mine, mine.createData(), *given)[order]
    found = maths(name).ask("dynamics", q, speed, acceleration)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


class Simulated:
    """An arm that a program's torques move: Pinocchio's forward dynamics, stepped as Gazebo steps them."""

    def __init__(self, maths: Maths, q: np.ndarray):
        self.model, self.order = dynamics_of("kr120")
        self.data = self.model.createData()
        self.maths, self.q, self.speed = maths, q.copy(), np.zeros(len(q))
        assert maths.ask("command", q + 3.0) and maths.ask("command", q)

    def step(self) -> None:
        torques = self.maths.ask("torques", self.q, self.speed)
        self.speed = self.speed + 0.001 * pinocchio.aba(self.model, self.data, self.q, self.speed, torques)
        self.q = self.q + 0.001 * self.speed

    def cycle(self, setpoint: np.ndarray) -> None:
        assert self.maths.ask("command", setpoint) == 0.0
        for _ in range(4):
            self.step()


def test_the_arm_answers_as_the_mock_s_realistic_servo_and_gives_what_mujoco_s_gives(maths):
    motion = between(READY, FAR, 1.5)
    arm, servo = Simulated(maths("kr120"), READY), RealisticServo(resolution=0.0)
    other = SimulatedArm(model_of(of=drives()), READY, Servo(holds=True))
    servo.reset(READY)
    efforts, others = [], []
    for setpoint in motion.sample_many(np.arange(0.0, 2.0, CYCLE))[0]:
        arm.cycle(setpoint)
        other.cycle(setpoint)
        np.testing.assert_allclose(arm.q, servo.step(setpoint.tolist()), atol=5e-5)
        efforts.append(arm.maths.ask("effort"))
        others.append(other.torque)
    np.testing.assert_allclose(arm.q, FAR, atol=1e-5)
    most = np.abs(others).max(axis=0)
    assert (np.abs(np.array(efforts) - others).max(axis=0) < 0.01 * most).all()


def test_an_axis_gives_no_more_than_it_has_and_then_lacks_it(maths):
    arm = Simulated(maths("kr120"), READY)
    # within a cycle 0.09 rad: no drive can do that
    arm.cycle(READY + 0.09)
    limits = np.array(drives().torque)
    np.testing.assert_allclose(np.abs(arm.maths.ask("effort")), limits)
    assert np.abs(arm.q - arm.maths.ask("answer")).max() > 1e-3


def test_an_arm_that_is_put_elsewhere_begins_there_at_rest(maths):
    arm = Simulated(maths("kr120"), READY)
    for _ in range(20):
        arm.cycle(READY + 0.05)
    assert arm.maths.ask("command", FAR) == 1.0
    np.testing.assert_array_equal(arm.maths.ask("answer"), FAR)
    model, order = dynamics_of("kr120")
    standing = pinocchio.computeGeneralizedGravity(model, model.createData(), FAR)
    np.testing.assert_allclose(arm.maths.ask("torques", FAR, np.zeros(6)), standing[order], rtol=1e-6, atol=1e-6)
