"""How smooth the gateway's corrections are: RMS acceleration and jerk over those of the planned trajectory.

Run by `link.py` (``--parts smoothness``). The gateway of `construction_twin.gateway.gateway` on a simulated clock, with simulated
arrivals of commands: the figures do not depend on the machine.

A profile is a link: when does a command that was sent at t arrive? MQTT runs over TCP, so a command never overtakes another. The
links are disturbed from the start: each runs for `WARM_UP` at rest before the motion, while the executor repeats the twin's pose.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import yaml
from link_world import ROBOT_YAML, ROOT, XACRO

from construction_twin.controller.telegram import Telegram
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS, radians
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.gateway import Gateway, State
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, Control, arm_value, reset_value
from construction_twin.planning.timing import time_path
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.ros.nodes.rsi_gateway import gateway_config

#: Time at rest before the motion: two of the long stalls [s].
WARM_UP = 12.0
#: Fraction of the limits that the trajectory uses.
LIMIT_FRACTION = 0.8
#: Poses of the motion, after home and before it [deg].
POSES = ((55.0, -50.0, 75.0, 40.0, 60.0, -70.0), (-40.0, -80.0, 100.0, -60.0, 110.0, 50.0))
#: Offset of the controller's cycle against the sender's [ns].
PHASE = 1_700_000
#: The sender's clock when ours reads 0 [ns].
SENDER_EPOCH = 1_790_000_000 * NANOSECONDS


@dataclass(frozen=True)
class Profile:
    """A link.

    Attributes:
        travel: From a random.Random to the travel time of the next command [ns].
        stalls: Period and length of stalls in which nothing arrives [s].
        cut: Begin, from the start of the motion, and length of one such stall [s]; () for none.
        loss: Fraction of commands that never arrive.
    """

    travel: Callable[[random.Random], int] = lambda _: 300_000
    stalls: tuple[float, float] = ()
    cut: tuple[float, float] = ()
    loss: float = 0.0

    def arrivals(self, sent: np.ndarray, seed: int) -> list[int | None]:
        """Return when each command of `sent` [ns from the start of the motion] arrives; None: never."""
        chance = random.Random(seed)
        times, last = [], -(1 << 62)
        for moment in sent.tolist():
            if chance.random() < self.loss:
                times.append(None)
                continue
            last = max(last + 1, self._released(moment + self.travel(chance)))
            times.append(last)
        return times

    def _released(self, arrival: int) -> int:
        if self.stalls:
            period, length = (round(value * NANOSECONDS) for value in self.stalls)
            # the first stall of a period begins half a period in
            into = (arrival - period // 2) % period
            arrival += max(0, length - into)
        if self.cut:
            begin, length = (round(value * NANOSECONDS) for value in self.cut)
            if begin <= arrival < begin + length:
                arrival = begin + length
        return arrival


def _delay_20_10(chance: random.Random) -> int:
    return chance.randrange(10_000_000, 30_000_001)


PROFILES = {
    "ideal": Profile(),
    "delay_20_10": Profile(travel=_delay_20_10),
    "stall_50ms_1s": Profile(stalls=(1.0, 0.05)),
    "stall_200ms_5s": Profile(stalls=(5.0, 0.2)),
    "cut_1s": Profile(cut=(2.5, 1.0)),
    "loss_1": Profile(loss=0.01),
    "loss_5": Profile(loss=0.05),
}


def planned_motion(robot: RobotModel) -> np.ndarray:
    """Return the motion on the 4 ms grid, at rest for `WARM_UP` before and for 2 s after; shape (m, n), rad."""
    path = np.array([robot.home, *map(radians, POSES), robot.home])
    motion = time_path(path, robot, speed_scale=LIMIT_FRACTION)
    times = np.arange(-WARM_UP, motion.duration + 2.0, CYCLE)
    return motion.sample_many(np.clip(times, 0.0, motion.duration))[0]


class Rig:
    """A gateway, a controller that carries out every reply, and a sender that begins a new session where it may.

    Args:
        start: Shape (n,). Pose of the arm [rad].
    """

    def __init__(self, config: GatewayConfig, start: tuple[float, ...]):
        self.gateway = Gateway(config, "benchmark")
        self.codec = JointStringCodec(len(config.axes), config.decimals)
        self.positions: list[tuple[float, ...]] = []
        self._config = config
        self._origin = self._pose = start
        self._cycles = 0
        self._sessions = 0
        self._controls = 0
        self._now = 0

    @property
    def session(self) -> str:
        """Id of the sender's present session."""
        return f"s{self._sessions}"

    def cycle(self, now: int) -> None:
        """Let the controller send a telegram and carry out the answer."""
        self._cycles, self._now = self._cycles + 1, now
        telegram = Telegram(4 * self._cycles, self._pose, self._origin, 0)
        correction = self.gateway.on_telegram(telegram, "controller", now)
        self._pose = tuple([start + value for start, value in zip(self._origin, correction)])
        self.positions.append(self._pose)

    def rearm(self) -> None:
        """Do what the bridge does when the arm rests near its twin (docs/architecture.md, law 5)."""
        if self.gateway.state is State.HOLDING and not self.gateway.fault:
            self._control("reset", reset_value(self.gateway.run, self.gateway.fault_number))
        if self.gateway.state is State.READY:
            self._sessions += 1
            self._control("arm", arm_value(self._config.hash, self.gateway.run))

    def _control(self, verb: str, value: object = None) -> None:
        self._controls += 1
        self.gateway.on_control(Control(str(self._controls), self.session, verb, value), self._now)


def play(motion: np.ndarray, config: GatewayConfig, profile: Profile, seed: int = 1) -> np.ndarray:
    """Send `motion` through the gateway over a link; return what it sent, one row per controller cycle, shape (k, n) [rad].

    Args:
        motion: Shape (m, n). One setpoint per 4 ms [rad].
        seed: Of the link's random numbers.
    """
    rig = Rig(config, tuple(motion[0].tolist()))
    start = round(WARM_UP * NANOSECONDS)
    sent = np.arange(len(motion), dtype=np.int64) * CYCLE_NS
    arrivals = profile.arrivals(sent - start, seed)
    poses = [rig.codec.encode(tuple(q)) for q in motion.tolist()]
    sessions: list[str] = []
    queue, waiting = [(at + start, k) for k, at in enumerate(arrivals) if at is not None], 0
    for cycle in range(len(motion)):
        now = cycle * CYCLE_NS + PHASE
        sessions.append(rig.session)
        while waiting < len(queue) and queue[waiting][0] <= now:
            at, k = queue[waiting]
            waiting += 1
            rig.gateway.on_command(poses[k], CommandProperties(sessions[k], k + 1, SENDER_EPOCH + int(sent[k])), at)
        rig.cycle(now)
        if cycle < round(WARM_UP / CYCLE) - 250:
            rig.rearm()
    return np.array(rig.positions)


def roughness(positions: np.ndarray, robot: RobotModel) -> tuple[float, float]:
    """Return root sums of squares of acceleration and jerk, each joint's in fractions of its own limit.

    Args:
        positions: Shape (k, n). One row per 4 ms [rad].
    """
    acceleration = np.diff(positions, 2, axis=0) / CYCLE**2
    jerk = np.diff(positions, 3, axis=0) / CYCLE**3
    limits = np.array(robot.acceleration), np.array(robot.jerk)
    return tuple(float(np.sqrt(np.sum((values / limit) ** 2))) for values, limit in zip((acceleration, jerk), limits))


def measure(decimals: int = 6) -> dict:
    """Return ``acc_ratio`` and ``jerk_ratio`` of every profile: what was played over what was planned."""
    robot = read_robot_files(XACRO, ROBOT_YAML)
    settings = yaml.safe_load((ROOT / "config" / "gateway.yaml").read_text())
    motion, config = planned_motion(robot), gateway_config(robot, settings | {"decimals": decimals})
    planned, found = roughness(motion, robot), {}
    for name, profile in PROFILES.items():
        played = roughness(play(motion, config, profile)[round((WARM_UP - 1.0) / CYCLE) :], robot)
        found[name] = {"ours": dict(zip(("acc_ratio", "jerk_ratio"), (one / two for one, two in zip(played, planned))))}
    return found
