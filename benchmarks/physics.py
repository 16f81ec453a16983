"""Physics benchmark: how fast the KR 120 with mass is simulated and rehearsed, and how right its torques are.

    python benchmarks/physics.py --output results/bench/physics.json

`real_time_factor`: simulated over real time of one moving arm with 20 blocks that lie on tables asleep, without a picture, as in
the moving part of a rehearsal; `real_time_factor_awake`: with the blocks awake, as while they settle. `rehearsal_s`: of plans of
1, 10 and 60 s among the same blocks; `settling_s`: before the motion and after it, with the blocks awake, which is not in
`rehearsal_s`. `rehearsal_wall_s`: of 10 s beside a wall of 20 bricks, as earlier tasks lay them, likewise, in CPU time.
`gravity_rel_error`: largest difference to Pinocchio's torques at rest over 1000 poses, of the largest torque of a pose.
`inverse_dynamics_rel_rms`: torques of a motion against Pinocchio's inverse dynamics. `live`: the twin beside the whole system
(`physics_live.py`), one kind after the other.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
from link_world import environment

from construction_twin.core.units import CYCLE
from construction_twin.extensions.physics.arm import Servo, SimulatedArm
from construction_twin.extensions.physics.drive import drives_of, read_drives
from construction_twin.extensions.physics.mass import GRAVITY
from construction_twin.extensions.physics.model import Load, build_model
from construction_twin.extensions.physics.rehearsal import Rehearsal
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.plan import Clearance, LimitUsage, Plan, PlanReport
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import read_self_collision

ROOT = Path(__file__).resolve().parents[1]
LIVE = Path(__file__).with_name("physics_live.py")
PACKAGES = ("mujoco-core", "numpy", "pin", "coal")
START = np.radians((0.0, -90.0, 90.0, 0.0, 45.0, 0.0))
GOAL = START + np.array((1.0, 0.3, -0.4, 0.8, -0.6, 1.2))
#: Simulated for the real-time factor [s]; plans that are rehearsed [s]; poses for gravity.
SIMULATED, PLANS, POSES = 10.0, (1.0, 10.0, 60.0), 1000
#: Bricks in each course of the wall, from below.
COURSES = (6, 5, 4, 3, 2)
_REST = (0.0, 0.0, -GRAVITY)


class Bench:
    """The robot among 20 blocks, and what is measured with it."""

    def __init__(self) -> None:
        self.robot = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
        self.bodies = RobotBodies(self.robot)
        self.pairs = read_self_collision(ROOT / "config/kr120_self_collision.yaml", self.robot)
        self.drives = read_drives(ROOT / "config/kr120_drives.yaml", self.robot)
        floor = SceneObject("floor", "box", (20.0, 20.0, 1.0), (0.0, 0.0, -0.5), fixed=True)
        table = SceneObject("table", "box", (4.0, 1.0, 0.5), (-3.0, 0.0, 0.25), (0.0, 0.0, 0.70710678, 0.70710678))
        blocks = [
            SceneObject(f"block {number}", "box", (0.24, 0.115, 0.071), (-3.0, -1.5 + 0.15 * number, 0.5355))
            for number in range(20)
        ]
        self.scene = Scene((floor, table, *blocks))
        self.masses = {block.name: 4.0 for block in blocks}

    def motion(self, duration: float) -> Trajectory:
        """Return a motion to and fro, 2 s each way, of the whole duration."""
        count = max(1, round(duration / 2.0))
        positions = np.array([GOAL if number % 2 else START for number in range(count + 1)])
        zeros = np.zeros_like(positions)
        times = np.linspace(0.0, duration, count + 1)
        return Trajectory(self.robot.joint_names, times, positions, zeros, zeros)

    def real_time_factor(self, asleep: bool) -> float:
        """Return simulated over real time."""
        load = Load(self.masses, {name: name for name in self.masses})
        physics = build_model(self.bodies, self.scene, self.pairs, self.drives, load)
        if asleep:
            physics.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        arm = SimulatedArm(physics, START)
        setpoints = self.motion(SIMULATED).sample_many(np.arange(0.0, SIMULATED, CYCLE))[0]
        for _ in range(250):
            arm.cycle(START)
        begin = time.perf_counter()
        for setpoint in setpoints:
            arm.cycle(setpoint)
        return SIMULATED / (time.perf_counter() - begin)

    def wall(self) -> Scene:
        """Return a wall of 20 bricks in running bond, behind the arm."""
        floor, *_ = self.scene.objects
        bricks = [
            SceneObject(
                f"brick {course}.{number}", "box", (0.115, 0.24, 0.071),
                (-2.5, (number - (count - 1) / 2) * 0.25, (course + 0.5) * 0.071),
            )
            for course, count in enumerate(COURSES)
            for number in range(count)
        ]  # fmt: skip
        return Scene((floor, *bricks))

    def rehearsal(
        self, duration: float, scene: Scene | None = None, clock: Callable[[], float] = time.perf_counter
    ) -> tuple[float, float]:
        """Return how long the rehearsal of a plan takes without what settles, and how long that takes [s].

        Args:
            scene: Of which all but the floor weighs 4 kg; None: that of the blocks.
        """
        around = self.scene if scene is None else scene
        masses = self.masses if scene is None else {item.name: 4.0 for item in around.objects if not item.fixed}
        motion = self.motion(duration)
        zeros = (0.0,) * len(self.robot.joint_names)
        report = PlanReport(Clearance(np.inf), LimitUsage(zeros, zeros, zeros), 0.0)
        plan = Plan("p", motion.content_hash(), "bench", "none", around.hash, 0, 0.0, motion, report)
        rehearsal = Rehearsal(self.bodies, self.pairs, self.drives, masses=masses)
        found = rehearsal.of_plan(plan, {around.hash: around}, clock)
        assert found.state == "passed", found.reasons
        return rounded(found.took - found.settle_took), rounded(found.settle_took)

    def gravity_rel_error(self) -> float:
        """Return the largest difference to Pinocchio, as a fraction of the largest torque of the pose."""
        physics = build_model(self.bodies, Scene(), self.pairs, drives_of(self.robot))
        model = self._pinocchio()
        data, own = model.createData(), physics.at_rest(START)
        worst = 0.0
        for q in np.random.default_rng(0).uniform(self.robot.lower, self.robot.upper, (POSES, len(START))):
            own.qpos[physics.joints] = q
            mujoco.mj_forward(physics.model, own)
            expected = pinocchio.computeGeneralizedGravity(model, data, self.bodies.rows(q[None])[0])[self.bodies.order]
            difference = np.abs(own.qfrc_bias[physics.joints] - expected).max()
            worst = max(worst, float(difference / np.abs(expected).max()))
        return worst

    def inverse_dynamics_rel_rms(self) -> float:
        """Return the root mean square of the difference to Pinocchio over a motion, as a fraction of that of the torques."""
        physics = build_model(self.bodies, Scene(), self.pairs, drives_of(self.robot))
        model, arm = self._pinocchio(), SimulatedArm(physics, START, Servo(saturates=False))
        data, found, path = model.createData(), [], []
        for setpoint in self.motion(2.0).sample_many(np.arange(0.0, 2.0, CYCLE))[0]:
            path.append(arm.q)
            for _step in arm.steps(setpoint):
                found.append(arm.needed)
                path.append(arm.q)
            path.pop()
        step = physics.model.opt.timestep
        speed = np.gradient(path, step, axis=0)
        states = np.stack((path, speed, np.gradient(speed, step, axis=0)))[:, :, np.argsort(self.bodies.order)]
        expected = np.array([pinocchio.rnea(model, data, *state)[self.bodies.order] for state in states.swapaxes(0, 1)])
        # at both ends the motion cannot be differentiated
        difference = (np.array(found) - expected)[5:-5]
        return float(np.sqrt(np.mean(difference**2) / np.mean(expected**2)))

    def _pinocchio(self) -> pinocchio.Model:
        model = self.bodies.model
        model.gravity.linear = np.array(_REST)
        return model


def live(twin: str) -> dict[str, float]:
    """Return rate, jitter and cost of a twin beside the whole system."""
    run = subprocess.run([sys.executable, LIVE, twin], stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(run.stdout)


def rounded(value: float) -> float:
    """Return a figure to three significant digits."""
    return float(f"{value:.3g}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description="Physics benchmark: speed of simulation and rehearsal, truth of torques."
    )
    parser.add_argument("--output", type=Path, default=ROOT / "results/bench/physics.json", help="file of the figures")
    options = parser.parse_args()
    bench = Bench()
    rehearsals = {f"{duration:g}": bench.rehearsal(duration) for duration in PLANS}
    figures: dict = {
        "real_time_factor": rounded(bench.real_time_factor(True)),
        "real_time_factor_awake": rounded(bench.real_time_factor(False)),
        "rehearsal_s": {name: motion for name, (motion, _settling) in rehearsals.items()},
        "settling_s": {name: settling for name, (_motion, settling) in rehearsals.items()},
        "rehearsal_wall_s": dict(zip(("motion", "settling"), bench.rehearsal(10.0, bench.wall(), time.process_time))),
        "gravity_rel_error": rounded(bench.gravity_rel_error()),
        "inverse_dynamics_rel_rms": rounded(bench.inverse_dynamics_rel_rms()),
        "live": {twin: live(twin) for twin in ("mujoco", "kinematic")},
    }
    for name in ("real_time_factor", "real_time_factor_awake"):
        print(f"{name:<32} {figures[name]:>10}")
    for name, (motion, settling) in rehearsals.items():
        print(f"rehearsal of {name:>2} s [s]              motion {motion}   settling {settling}")
    values = figures["rehearsal_wall_s"]
    print("rehearsal of 10 s, wall [s CPU]  " + "".join(f"{key:>10} {value}" for key, value in values.items()))
    for twin, values in figures["live"].items():
        print(f"live {twin:<27} " + "".join(f"{key:>14} {value}" for key, value in values.items()))
    for name in ("gravity_rel_error", "inverse_dynamics_rel_rms"):
        print(f"{name:<32} {figures[name]:>10}")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(figures | {"environment": environment(PACKAGES)}, indent=2) + "\n")
    print(f"written to {options.output}")


if __name__ == "__main__":
    main()
