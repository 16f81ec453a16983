"""What `make soak ARGS=faults` promises, and whether what was seen of one leg kept it. Pure: values in, findings out.

Times are those of the monotonic clock [s]; angles in rad. A leg is what happens between two moments at which the arm rests and a
plan could be approved; one fault lies in it. Where the machine itself stood still (`Leg.pauses`), what is out of order for a moment
proves nothing: it is counted as disturbed, and is no violation.
"""

from __future__ import annotations

import statistics
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

#: An approval, and a resume, start motion so long after what its person saw, or not at all [s] (docs/reference/mqtt.md).
LIFETIME = 3.0
#: From the executor's act to what the arm does and we hear of it: round trip, playout, servo, a busy machine [s].
LATENCY = 0.5
#: How far the arm goes without an approval, on any joint: the remainder of a start tolerance of 0.05 deg [rad].
BLEND = 1.0e-3
#: Steps below this are rounding, not motion; the arm has come to rest when it stood for so long [rad], [s].
STILL, REST = 1.0e-7, 0.3
#: A record is looked for every 10 ms: an approval that is seen so much later than its motion may have been there before [s].
LOOK = 0.05
#: How long after a stop's answer the link may still say ARMED: it reports once a second, and on change [s].
REPORTED = 1.5
#: A stop counts as watched when so much of it was seen [s].
WATCHED = 2.0
#: The arm follows the twin by no more than this [s]: the playout's delay, the servo and the gate's allowance. By what it is told to
#: trail its stream, because replies were lost, comes on top (docs/conventions.md, Lost replies).
FOLLOWS = 0.6
#: Poses of the arm and what is told of them are heard within this of each other [s].
HEARD = 0.1
#: Where the twin was not heard for longer, by whoever listens, nothing is known of where it was; one that stops telling closes the
#: gate after 0.1 s [s].
UNHEARD = 0.05
#: A pause of the machine of this length explains what is out of order until so long after it [s].
PAUSE, AFTERMATH = 0.02, 2.0
#: Growth of a process's memory up to here is noise [MB]; fewer samples than this prove nothing.
MAX_GROWTH, MIN_SAMPLES = 4.0, 6


@dataclass(frozen=True)
class Samples:
    """Poses as they were heard: time, number of the message, positions, shape (k,), (k,), (k, n)."""

    times: np.ndarray
    numbers: np.ndarray
    positions: np.ndarray


@dataclass(frozen=True)
class Motion:
    """A motion of the arm from rest to rest: `travel` is how far the joint that moved most went, there and back counted."""

    begin: float
    end: float
    travel: float


@dataclass(frozen=True)
class Permission:
    """An approval or a resume that was answered with ok.

    Attributes:
        moment: When the person saw what was decided on: the call by ROS, the view's moment by MQTT.
        recorded: When the verdict was first seen in the review file; None: never. A resume has no record.
    """

    plan: str
    moment: float
    recorded: float | None = None
    resume: bool = False


@dataclass(frozen=True)
class Play:
    """A stretch in which the executor said that it plays a plan; one that is paused ends it."""

    plan: str
    begin: float
    end: float


@dataclass(frozen=True)
class Stop:
    """A stop, pause, halt or rejection that was answered with ok.

    Attributes:
        route: What was pressed, for sentences.
        cleared: When a person undid it: the next reset that was called, or the next approval or resume; the end of the watch for
            none.
        at_gateway: It ends in NEEDS_RESET: nothing may be armed before a reset.
    """

    route: str
    answered: float
    cleared: float
    at_gateway: bool = False


@dataclass(frozen=True)
class Stretch:
    """A stretch of time, and what it is called."""

    begin: float
    end: float
    name: str = ""

    def holds(self, time: float) -> bool:
        """Whether `time` lies in it."""
        return self.begin <= time <= self.end


@dataclass(frozen=True)
class Refusal:
    """A request that had to be refused: what was asked, whether it was, and what `/diagnostics` counted for it ("" for nothing)."""

    what: str
    refused: bool
    counted: str


@dataclass(frozen=True)
class Trace:
    """What the gateway recorded: cycles, cycles that say that a reply was lost, and where limits were left."""

    cycles: int
    lost: int = 0
    excesses: tuple[str, ...] = ()


def _time_of(entry: tuple[float, float]) -> float:
    return entry[0]


@dataclass(frozen=True)
class Leg:
    """All that was seen of one leg.

    `velocity` [rad/s] per joint; `braking` is the time in which any motion ends [s]; `trail` holds times, and by how much the arm
    trailed its stream from then on [s].
    """

    arm: Samples
    twin: Samples
    velocity: tuple[float, ...]
    braking: float
    threshold: tuple[float, ...]
    fault: Stretch
    end: float
    cycle: float = 0.004
    permissions: tuple[Permission, ...] = ()
    plays: tuple[Play, ...] = ()
    stops: tuple[Stop, ...] = ()
    armed: tuple[Stretch, ...] = ()
    in_sync: tuple[Stretch, ...] = ()
    holds: tuple[Stretch, ...] = ()
    pauses: tuple[Stretch, ...] = ()
    trail: tuple[tuple[float, float], ...] = ()
    trace: Trace = Trace(0)
    chain: str = ""
    records: int = 0
    refusals: tuple[Refusal, ...] = ()
    nodes_before: Mapping[str, int] = field(default_factory=dict)
    nodes_after: Mapping[str, int] = field(default_factory=dict)
    killed: frozenset[str] = frozenset()
    retained_before: frozenset[str] = frozenset()
    retained_after: frozenset[str] = frozenset()
    log: tuple[str, ...] = ()
    log_lines: int = 0
    failed: str = ""

    def follows(self, time: float) -> float:
        """Return by how much the arm may follow the twin [s]: as it was told about this time."""
        first = bisect_right(self.trail, time - HEARD, key=_time_of)
        last = bisect_right(self.trail, time + HEARD, key=_time_of)
        return FOLLOWS + max((seconds for _, seconds in self.trail[max(0, first - 1) : last]), default=0.0)

    def disturbed(self, begin: float, end: float) -> bool:
        """Whether the machine stood still while something happened, or just before."""
        return any(p.end - p.begin >= PAUSE and p.begin <= end and p.end >= begin - AFTERMATH for p in self.pauses)


@dataclass(frozen=True)
class Finding:
    """How often a promise was put to the test, how it was broken, and what a pause of the machine explains."""

    exercised: int
    violations: tuple[str, ...] = ()
    disturbed: int = 0

    def __add__(self, other: Finding) -> Finding:
        return Finding(
            self.exercised + other.exercised,
            self.violations + other.violations,
            self.disturbed + other.disturbed,
        )


def motions(arm: Samples) -> list[Motion]:
    """Return the motions of the arm, oldest first; rests shorter than `REST` do not end one."""
    if len(arm.times) < 2:
        return []
    steps = np.abs(np.diff(arm.positions, axis=0))
    moving = np.flatnonzero(steps.max(axis=1) > STILL)
    if not len(moving):
        return []
    times = arm.times
    breaks = np.flatnonzero(times[moving[1:]] - times[moving[:-1] + 1] > REST)
    firsts, lasts = moving[np.r_[0, breaks + 1]], moving[np.r_[breaks, len(moving) - 1]]
    return [
        Motion(float(times[a]), float(times[b + 1]), float(steps[a : b + 1].sum(axis=0).max()))
        for a, b in zip(firsts, lasts)
    ]


# -- promises, each for one leg


def no_motion_without_approval(leg: Leg) -> Finding:
    """No motion of the arm without an approval that is not older than 3 s, each for one motion."""
    used: set[Permission] = set()
    wrong, seen = [], 0
    for motion in motions(leg.arm):
        if motion.travel <= BLEND:
            continue
        seen += 1
        granted = [p for p in leg.permissions if p not in used and 0.0 <= motion.begin - p.moment <= LIFETIME + LATENCY]
        if granted:
            used.add(granted[-1])
        elif not _goes_on(leg, motion, used):
            wrong.append(
                f"the arm moved by {motion.travel:.4f} rad for {motion.end - motion.begin:.2f} s "
                f"without an approval of the {LIFETIME:g} s before"
            )
    return Finding(seen, tuple(wrong))


def _goes_on(leg: Leg, motion: Motion, used: set[Permission]) -> bool:
    """Whether a motion is the rest of one that was approved: its plan is being played, and was not paused."""
    plans = {permission.plan for permission in used}
    return any(play.plan in plans and play.begin - LATENCY <= motion.begin <= play.end + LATENCY for play in leg.plays)


def approval_recorded_before_motion(leg: Leg) -> Finding:
    """Each approval is in the review file before the arm moves."""
    wrong, seen = [], 0
    moved = [motion for motion in motions(leg.arm) if motion.travel > BLEND]
    for permission in leg.permissions:
        if permission.resume:
            continue
        first = next((m.begin for m in moved if m.begin >= permission.moment), None)
        if first is None or first > permission.moment + LIFETIME + LATENCY:
            continue
        seen += 1
        if permission.recorded is None:
            wrong.append(f"plan {permission.plan} moved the arm, and no approval of it is on record")
        elif permission.recorded > first + LOOK:
            wrong.append(f"plan {permission.plan} was recorded {permission.recorded - first:.3f} s after its motion")
    return Finding(seen, tuple(wrong))


def every_stop_stands(leg: Leg) -> Finding:
    """Every stop brakes in time; nothing moves and nothing is armed after it before a person undoes it."""
    wrong, seen, disturbed = [], 0, 0
    for stop in leg.stops:
        rest = stop.answered + leg.braking + LATENCY
        seen += stop.cleared - stop.answered >= WATCHED
        for motion in motions(leg.arm):
            later = motion.end > rest and motion.begin < stop.cleared and motion.travel > BLEND
            if later and stop.answered < min(motion.end, stop.cleared):
                # one that begins with what cleared the stop is judged as any motion
                if motion.begin > stop.cleared - LOOK:
                    continue
                if leg.disturbed(stop.answered, rest):
                    disturbed += 1
                    continue
                late = min(motion.end, stop.cleared) - stop.answered
                wrong.append(f"{stop.route}: the arm moved {late:.2f} s after the answer, before anybody undid it")
        if stop.at_gateway:
            wrong += [
                f"{stop.route}: the link was ARMED {s.begin - stop.answered:+.2f} s from the answer, before a reset"
                for s in leg.armed
                if s.end > stop.answered + REPORTED
                and s.begin < stop.cleared
                and s.end - s.begin > 0.0
                and max(s.begin, stop.answered + REPORTED) < min(s.end, stop.cleared)
            ]
    return Finding(seen, tuple(wrong), disturbed)


def within_limits(leg: Leg) -> Finding:
    """What the gateway sent is inside the limits of range, velocity and acceleration, in every cycle."""
    return Finding(leg.trace.cycles, leg.trace.excesses)


def no_step(leg: Leg) -> Finding:
    """The arm makes no step: in no cycle does a joint go further than its velocity allows, replies lost or not."""
    if len(leg.arm.times) < 2:
        return Finding(0)
    steps = np.abs(np.diff(leg.arm.positions, axis=0))
    cycles = np.maximum(np.diff(leg.arm.numbers), 1)[:, None]
    # the wire's rounding at both ends of a step
    allowed = np.array(leg.velocity) * leg.cycle * cycles + 2.0e-5
    wrong = np.flatnonzero((steps > allowed).any(axis=1))
    return Finding(
        len(steps),
        tuple(f"a step of {np.rad2deg(steps[k].max()):.4f} deg in {int(cycles[k][0])} cycles" for k in wrong[:5]),
    )


def twin_and_arm_agree(leg: Leg) -> Finding:
    """While the gate says IN_SYNC the arm is where the twin is, or was just before, within the gate's threshold."""
    wrong, seen, disturbed = [], 0, 0
    threshold = np.array(leg.threshold)
    for k in range(0, len(leg.arm.times), 25):
        time = leg.arm.times[k]
        # the gate reacts on what it hears, we hear its word a moment later
        if not any(s.begin + 0.1 <= time <= s.end - LATENCY for s in leg.in_sync):
            continue
        first, last = np.searchsorted(leg.twin.times, (time - leg.follows(time), time + 0.1))
        if first == last:
            continue
        seen += 1
        if (np.diff(leg.twin.times[first:last], prepend=time - leg.follows(time), append=time) > UNHEARD).any():
            disturbed += 1
            continue
        off = (np.abs(leg.twin.positions[first:last] - leg.arm.positions[k]) - threshold).max(axis=1).min()
        if off <= 0.0:
            continue
        if leg.disturbed(time, time):
            disturbed += 1
        else:
            wrong.append(f"IN_SYNC, and {off:.4f} rad beyond the threshold from every pose of the twin just before")
    return Finding(seen, tuple(wrong[:5]), disturbed)


def no_hold_without_cause(leg: Leg) -> Finding:
    """The gate closes for a fault, or because the machine stood still, and never else."""
    wrong, disturbed = [], 0
    for hold in leg.holds:
        if leg.fault.begin - LATENCY <= hold.begin <= leg.fault.end:
            continue
        if leg.disturbed(hold.begin, hold.begin):
            disturbed += 1
        else:
            wrong.append(f"the gate closed without a fault: {hold.name}")
    return Finding(len(leg.plays), tuple(wrong), disturbed)


def record_chain_is_intact(leg: Leg) -> Finding:
    """`review_log` finds the chain of the review file whole."""
    return Finding(leg.records, (leg.chain,) if leg.chain else ())


def refusals_are_counted(leg: Leg) -> Finding:
    """What must be refused is, and each refusal is counted on /diagnostics."""
    wrong = [f"{r.what} was not refused" for r in leg.refusals if not r.refused]
    wrong += [f"{r.what} was refused, and nothing on /diagnostics counted it" for r in leg.refusals if not r.counted]
    return Finding(len(leg.refusals), tuple(wrong))


def nodes_live(leg: Leg) -> Finding:
    """No program ends but those that were killed, and each of those is back."""
    wrong = []
    for name, before in leg.nodes_before.items():
        after = leg.nodes_after.get(name)
        if after is None:
            wrong.append(f"{name} is gone" + (", killed and not started again" if name in leg.killed else ""))
        elif (after != before) and name not in leg.killed:
            wrong.append(f"{name} ended and was started again, and nobody killed it")
        elif after == before and name in leg.killed:
            wrong.append(f"{name} was to be killed, and was not")
    return Finding(len(leg.nodes_before), tuple(wrong))


def retained_topics_are_back(leg: Leg) -> Finding:
    """Every topic that was retained at the broker is again."""
    gone = sorted(leg.retained_before - leg.retained_after)
    return Finding(len(leg.retained_before), tuple(f"{topic} is not retained any more" for topic in gone))


def nothing_unannounced_in_the_log(leg: Leg) -> Finding:
    """No line ERROR, FATAL or Traceback is in a log that the fault does not announce."""
    return Finding(leg.log_lines, leg.log)


def comes_back(leg: Leg) -> Finding:
    """After every fault a person's reset and a new plan bring the system back."""
    return Finding(1, (leg.failed,) if leg.failed else ())


PROMISES: dict[str, Callable[[Leg], Finding]] = {
    "no approval, no motion": no_motion_without_approval,
    "recorded before motion": approval_recorded_before_motion,
    "a stop brakes and stands": every_stop_stands,
    "corrections within limits": within_limits,
    "no step": no_step,
    "twin and arm agree": twin_and_arm_agree,
    "no hold without a cause": no_hold_without_cause,
    "record chain intact": record_chain_is_intact,
    "refused and counted": refusals_are_counted,
    "programs live or come back": nodes_live,
    "retained topics are back": retained_topics_are_back,
    "no unannounced error": nothing_unannounced_in_the_log,
    "a person brings it back": comes_back,
}
#: Judged over the whole run.
MEMORY = "memory does not grow"


def judge(leg: Leg) -> dict[str, Finding]:
    """Return what each promise came to in a leg."""
    return {name: promise(leg) for name, promise in PROMISES.items()}


def memory_does_not_grow(samples: Mapping[str, Sequence[float]]) -> Finding:
    """Compare the medians of the first and the last third of each program's resident memory [MB], one sample per leg.

    The first sample, while a program warms up, does not count, where there are enough without it.
    """
    wrong, seen = [], 0
    for name, values in samples.items():
        settled = values[1:]
        if len(settled) < MIN_SAMPLES:
            continue
        seen += 1
        third = len(settled) // 3
        first, last = statistics.median(settled[:third]), statistics.median(settled[-third:])
        if last - first > MAX_GROWTH:
            wrong.append(f"{name} grew from {first:.1f} to {last:.1f} MB")
    return Finding(seen, tuple(wrong))


def total(findings: Iterable[Mapping[str, Finding]]) -> dict[str, Finding]:
    """Return the sum over legs of what each promise came to."""
    sums: dict[str, Finding] = {}
    for each in findings:
        for name, finding in each.items():
            sums[name] = sums.get(name, Finding(0)) + finding
    return sums


def table(sums: Mapping[str, Finding]) -> str:
    """Return the summary: promise, how often it was put to the test, disturbed by the machine, violations."""
    width = max(map(len, sums))
    rows = [f"{'promise':{width}s} {'exercised':>10s} {'disturbed':>10s} {'violations':>11s}"]
    rows += [
        f"{name:{width}s} {finding.exercised:10d} {finding.disturbed:10d} {len(finding.violations):11d}"
        for name, finding in sums.items()
    ]
    return "\n".join(rows)


def never_exercised(sums: Mapping[str, Finding]) -> list[str]:
    """Return the promises that nothing put to the test: a table of them proves nothing."""
    return [name for name, finding in sums.items() if not finding.exercised]
