"""The simulated chain of the shipped robot, and what every run of it is judged by. Angles in rad."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import plan_samples
import yaml
from simulation import SimulatedChain, SimulatedLink

from construction_twin.core.units import format_allowance, radians
from construction_twin.mock.program import MockSettings, build_controller
from construction_twin.monitor.settings import GateSettings
from construction_twin.planning.timing import time_path
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.plan import Plan
from construction_twin.ros.nodes.rsi_gateway import gateway_config
from construction_twin.servo.model import ServoModel
from construction_twin.twin.virtual_robot import KinematicBackend, TwinBackend

ROOT = Path(__file__).resolve().parents[2]
ROBOT = read_robot_files(ROOT / "urdf" / "kr120r2500.urdf.xacro", ROOT / "config" / "kr120.yaml")
SETTINGS = yaml.safe_load((ROOT / "config" / "gateway.yaml").read_text())
REACH = radians((55.0, -50.0, 75.0, 40.0, 60.0, -70.0))


def make_chain(
    decimals: int,
    servo: str = "ideal",
    link: SimulatedLink = SimulatedLink(),
    gate: GateSettings = GateSettings(),
    backend: TwinBackend = KinematicBackend(),
    servos: ServoModel | None = None,
    **settings,
) -> SimulatedChain:
    """Return a chain that is ready for a plan; `settings` are the gateway's."""
    config = gateway_config(ROBOT, SETTINGS | {"decimals": decimals} | settings)
    shared = {name: settings[name] for name in ("ethernet_xml", "tool") if name in settings}
    mock = MockSettings(gateway_host="simulated", gateway_port=1, servo=servo, cycle=config.cycle, **shared)
    chain = SimulatedChain(ROBOT, config, build_controller(mock, ROBOT), gate, link, backend=backend, servos=servos)
    assert chain.run_until(lambda: chain.ready, 5.0), (
        chain.supervisor.reason,
        chain.executor.reason,
        chain.gate.reason,
    )
    return chain


def make_plan(chain: SimulatedChain, goal, robot=ROBOT, **timing) -> Plan:
    """Return a plan from the twin's pose to `goal`, timed as `time_path` is told."""
    trajectory = time_path(np.array([chain.twin.pose, goal]), robot, **timing)
    return plan_samples.make_plan(trajectory, f"plan-{chain.now}", asked_ns=chain.now)


def play_to_the_end(chain: SimulatedChain, plan: Plan) -> None:
    """Play a plan and let the arm come to rest."""
    chain.play(plan)
    assert chain.run_until(lambda: chain.executor.outcome == "finished", plan.trajectory.duration + 5.0), (
        chain.executor.reason
    )
    chain.run_for(0.5)


def assert_corrections_inside_limits(chain: SimulatedChain) -> None:
    """Range, velocity and acceleration of every correction, with the format's allowance."""
    # what the controller applies is rounded to the 6 decimals of AK
    applied = np.radians(np.round(np.degrees([correction for _, correction in chain.corrections]), 6))
    position = applied + np.array(ROBOT.home)
    decimals, cycle = chain.gateway.config.decimals, chain.gateway.config.period
    velocity = np.diff(applied, axis=0) / cycle
    acceleration = np.diff(velocity, axis=0) / cycle
    assert (position >= np.array(ROBOT.lower) - 1e-8).all() and (position <= np.array(ROBOT.upper) + 1e-8).all()
    assert (np.abs(velocity) <= np.array(ROBOT.velocity) + math.radians(10.0**-decimals) / cycle).all()
    allowed = np.array(ROBOT.acceleration) + format_allowance(decimals, cycle=cycle) + format_allowance(6, cycle=cycle)
    assert (np.abs(acceleration) <= allowed).all()
