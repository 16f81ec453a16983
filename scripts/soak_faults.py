"""Faults every few minutes for two hours, and every promise checked after each: `make soak ARGS=faults`.

The real bringup with the mock arm runs on ports, a disk and a wall clock of its own. A scripted person plans and approves; in the
middle of motions, or at rest, one fault after another comes, in an order drawn from the seed, each kind once before any comes
again. One line per fault, a table at the end; what each leg came to goes to results/soak/faults.json. The exit code is 0 if no
promise was broken and each was put to the test. Needs root: the disk that is filled is a tmpfs, in a mount namespace of its own.
`python scripts/soak_faults.py --minutes 6 --every 20` is a short one; `--only "kill broker" "disk full"` takes these faults alone.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
for folder in ("benchmarks", "test/support", "test/integration"):
    sys.path.insert(0, str(ROOT / folder))

import rospy  # noqa: E402
from link_world import end_in_order, environment, resident_mb  # noqa: E402
from machine import MachineProbe  # noqa: E402
from mqtt_listener import retained  # noqa: E402
from soak_deck import FAULTS, NEW_TRACE, Fault  # noqa: E402
from soak_judge import (  # noqa: E402
    MEMORY,
    Finding,
    Leg,
    Stretch,
    Trace,
    judge,
    memory_does_not_grow,
    never_exercised,
    table,
    total,
)
from soak_operator import FAILURES, Operator  # noqa: E402
from soak_witness import Witness  # noqa: E402
from soak_world import ROBOT, SoakWorld, wait_while  # noqa: E402

from construction_twin.core.errors import ConfigurationError  # noqa: E402
from construction_twin.review.chained_file import verify  # noqa: E402
from construction_twin.ros.shared.gateway_config import config_from_parameters  # noqa: E402
from construction_twin.scenario.trace_check import trace_excesses  # noqa: E402

#: A trace holds 900,000 cycles: the gateway is killed, and so begins a new one, before it is full.
MOST_TRACED = 700_000
#: Time between two wake-ups of the machine's probe [ns]: it looks for pauses that hold an arm, not for single late replies.
PROBE_PERIOD = 4_000_000
#: How long killed programs, and retained topics, may take to come back [s].
RETURN = 30.0
#: Motions that are begun before a person gives up: one may be held because the machine stood still.
TRIES = 3
#: Retained while a plan waits for a verdict only.
PASSING = ("/plan",)
RESULT = ROOT / "results" / "soak" / "faults.json"


def in_its_own_mounts() -> None:
    """Start this program again in a mount namespace of its own, where it is not yet: its disk ends with it, however it ends.

    There it also lives in the robot's namespace, which rospy reads when it is imported.
    """
    if os.environ.get("SOAK_MOUNTS") != "own":
        os.environ |= {"SOAK_MOUNTS": "own", "ROS_NAMESPACE": f"/{ROBOT}"}
        os.execvp("unshare", ["unshare", "--mount", "--propagation", "private", sys.executable, *sys.argv])


def drawn(faults: Sequence[Fault], chance: random.Random, world: SoakWorld) -> Iterator[Fault]:
    """Yield faults without end: each kind once in an order of chance, then again; a new trace in time."""
    while True:
        round_ = list(faults)
        chance.shuffle(round_)
        for fault in round_:
            if world.traced > MOST_TRACED and fault is not NEW_TRACE:
                yield NEW_TRACE
            yield fault


class Soak:
    """The robot, the person, and what is taken of each leg."""

    def __init__(self, world: SoakWorld, probe: MachineProbe, chance: random.Random):
        self.world, self.probe, self.chance = world, probe, chance
        self.witness = Witness(world.review_file)
        self.operator = Operator(self.witness, world.folder, world.ports.broker, chance)
        self.operator.back()
        self.operator.client.wait(lambda: retained(world.ports.broker), "retained topics", RETURN)
        self.robot, self.limits = self.operator.client.robot, config_from_parameters(needs_file=False).limits
        self.braking = max(v / a for v, a in zip(self.robot.velocity, self.robot.acceleration))
        self.memory: dict[str, list[float]] = {}
        self._take(Fault("start", lambda *_: ""), {}, frozenset(), time.monotonic(), time.monotonic(), "")

    def leg(self, fault: Fault, length: float) -> tuple[Leg, str]:
        """Let a fault come, bring the robot back, let it work until `length` [s] are over; return what was seen, and a remark."""
        begin = time.monotonic()
        nodes, topics = self.world.nodes(), self._retained()
        remark, failed = "", ""
        came = back = begin
        try:
            self.operator.back()
            if not fault.at_rest:
                self._go_under_way()
            came = time.monotonic()
            remark = fault.act(self.operator, self.world)
            self.operator.back()
            back = time.monotonic()
            assert any(self.operator.play() for _ in range(TRIES)), f"none of {TRIES} motions after it was finished"
            while time.monotonic() - begin < length:
                self.operator.play()
        except FAILURES as error:
            failed = f"{fault.name}: {error}"
            if back == begin:
                back = time.monotonic()
            try:
                self.operator.back()
            except FAILURES as again:
                failed += f"; then: {again}"
        if fault.killed:
            self.world.wait_for_nodes(set(nodes), RETURN)
        wait_while(lambda: not topics <= self._retained(), RETURN, 0.5)
        return self._take(fault, nodes, topics, came, back, failed), remark

    def _go_under_way(self) -> None:
        """Begin a motion, and go on some way into it; again when the gate holds it: whether it may is judged beside."""
        for _ in range(TRIES):
            plan = self.operator.start()
            time.sleep(self.chance.uniform(0.1, 0.6) * plan.duration)
            if self.operator.plays(plan.plan_id):
                return
            self.operator.back()
        raise AssertionError(f"none of {TRIES} motions was under way for long enough")

    def _take(self, fault, nodes, topics, came: float, back: float, failed: str) -> Leg:
        """Return what was seen since the last call."""
        world, witness = self.world, self.witness
        end = time.monotonic()
        after = world.nodes()
        for name, pid in after.items():
            self.memory.setdefault(name, []).append(resident_mb(pid))
        entries = world.traces()
        excesses = [x for run in entries for x in trace_excesses(run, self.limits, self.operator.client.decimals)]
        count, bad = world.new_log_lines()
        announced = re.compile("|".join(fault.announces)) if fault.announces else None
        machine = self.probe.taken()
        in_sync, holds = witness.gate(end)
        lines = witness.records.lines
        leg = Leg(
            arm=witness.arm.take(),
            twin=witness.twin.take(),
            velocity=tuple(self.robot.velocity),
            braking=self.braking,
            threshold=tuple(self.operator.client.sync.threshold),
            fault=Stretch(came, back if fault.causes_holds else came, fault.name),
            end=end,
            permissions=tuple(
                type(p)(p.plan, p.moment, witness.records.approved.get(p.plan), p.resume)
                for p in self.operator.permissions
            ),
            plays=witness.plays(end),
            stops=self.operator.stops(end),
            armed=witness.armed(end),
            in_sync=in_sync,
            holds=holds,
            pauses=tuple(Stretch(begin / 1e9, over / 1e9) for begin, over in machine["intervals"]),
            trail=witness.trail.take(),
            trace=Trace(
                sum(map(len, entries)), sum(e.lost for run in entries for e in run), tuple(map(str, excesses[:5]))
            ),
            chain=self._chain(),
            records=lines,
            refusals=tuple(self.operator.refusals),
            nodes_before=nodes,
            nodes_after=after,
            killed=fault.killed,
            retained_before=topics,
            retained_after=self._retained(),
            log=tuple(line for line in bad if not (announced and announced.search(line))),
            log_lines=count,
            failed=failed,
        )
        self.operator.forget()
        return leg

    def _chain(self) -> str:
        try:
            verify(self.world.review_file)
        except ConfigurationError as error:
            return str(error)
        return ""

    def _retained(self) -> frozenset[str]:
        return frozenset(topic for topic in retained(self.world.ports.broker) if not topic.endswith(PASSING))


def line_of(number: int, fault: Fault, leg: Leg, findings: dict[str, Finding], remark: str) -> str:
    """Return a leg in one line, and each violation in one more."""
    broken = [f"    BROKEN {name}: {what}" for name, found in findings.items() for what in found.violations]
    longest = max((p.end - p.begin for p in leg.pauses), default=0.0)
    head = (
        f"{number:4d} {fault.name:24s} back after {leg.fault.end - leg.fault.begin:5.1f} s, {len(leg.permissions):3d} approvals, "
        f"{len(leg.holds):2d} holds, {leg.trace.lost:4d} replies lost, longest pause {1000 * longest:4.0f} ms  {remark}"
    )
    return "\n".join([head, *broken])


def main(arguments: list[str] | None = None) -> int:
    """Run the soak; return the exit code."""
    parser = argparse.ArgumentParser(description="Faults every few minutes, every promise checked after each.")
    parser.add_argument("--minutes", type=float, default=120.0, help="[%(default)s]")
    parser.add_argument("--every", type=float, default=180.0, help="length of a leg with one fault [s] [%(default)s]")
    parser.add_argument("--seed", type=int, default=None, help="of what is left to chance [drawn, and printed]")
    parser.add_argument("--only", nargs="+", default=[], metavar="FAULT", help="these faults alone, by name")
    parser.add_argument("--keep", type=Path, help="an empty folder that keeps the logs [none]")
    options = parser.parse_args(arguments)
    unknown = set(options.only) - {fault.name for fault in FAULTS}
    if unknown:
        parser.error(f"no such fault: {', '.join(sorted(unknown))}; there are {', '.join(f.name for f in FAULTS)}")
    if os.geteuid():
        print("soak: the disk that is filled is a tmpfs, and only root may mount one: run it as root", file=sys.stderr)
        return 2
    in_its_own_mounts()
    end_in_order()
    seed = random.SystemRandom().randrange(1 << 32) if options.seed is None else options.seed
    chance = random.Random(seed)
    print(f"[soak] seed {seed}, {options.minutes:g} minutes, a fault every {options.every:g} s", flush=True)
    faults = [fault for fault in FAULTS if not options.only or fault.name in options.only]
    legs: list[dict] = []
    results: list[dict[str, Finding]] = []
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="soak_") as temporary:
        place = options.keep or Path(temporary)
        place.mkdir(parents=True, exist_ok=True)
        with SoakWorld(place) as world:
            rospy.init_node("soak", disable_signals=True)
            world.wait_for_parameters(f"/{ROBOT}/gateway/decimals", f"/{ROBOT}/mqtt_bridge/port")
            soak = Soak(world, world.enter_context(MachineProbe(40, PROBE_PERIOD)), chance)
            world.callback(rospy.signal_shutdown, "done")
            world.callback(soak.witness.records.close)
            for number, fault in enumerate(drawn(faults, chance, world), 1):
                if time.monotonic() - began > options.minutes * 60.0:
                    break
                leg, remark = soak.leg(fault, options.every)
                findings = judge(leg)
                results.append(findings)
                print(line_of(number, fault, leg, findings, remark), flush=True)
                legs.append(
                    {"fault": fault.name, "remark": remark, "findings": {k: asdict(v) for k, v in findings.items()}}
                )
                world.alive()
            sums = total(results) | {MEMORY: memory_does_not_grow(soak.memory)}
            sizes = {name: [round(v, 1) for v in values] for name, values in soak.memory.items()}
            if options.keep:
                world.keep_logs()
    print(table(sums))
    unproven = never_exercised(sums)
    broken = sum(len(finding.violations) for finding in sums.values())
    for name, values in sorted(sizes.items()):
        print(
            f"memory of {name}: {values[0]} MB at first, {statistics.median(values)} MB at the median, {values[-1]} MB at last"
        )
    if unproven:
        print(f"not put to the test: {', '.join(unproven)}")
    minutes = (time.monotonic() - began) / 60.0
    print(
        f"verdict: {len(legs)} faults in {minutes:.0f} minutes, seed {seed}: "
        + (f"{broken} violations" if broken else "every promise kept")
    )
    RESULT.parent.mkdir(parents=True, exist_ok=True)
    document = {"seed": seed, "minutes": minutes, "environment": environment(), "memory_mb": sizes, "legs": legs}
    document["promises"] = {name: asdict(finding) for name, finding in sums.items()}
    RESULT.write_text(json.dumps(document, indent=1))
    print(f"written to {RESULT.relative_to(ROOT)}")
    return 1 if broken or (unproven and not options.only) else 0


if __name__ == "__main__":
    sys.exit(main())
