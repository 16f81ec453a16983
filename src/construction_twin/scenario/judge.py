"""Judges a recorded run of a scenario against its expectation.

Errors are physical - twin. Where a pose says which command it answers to, the twin's pose for that command is taken, and
what the servo lag explains is left in; where it does not (the gateway brakes or holds) the twin's present pose is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from construction_twin.core.limits import RANGE_SLACK, MotionLimits
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS, radians
from construction_twin.evaluation.alignment import TwinPath, Window, align_by_command, align_lag_removed
from construction_twin.gateway.states import HELD
from construction_twin.gateway.trace import TraceEntry
from construction_twin.mock.faults import KINDS
from construction_twin.scenario.definition import Scenario
from construction_twin.scenario.timeline import Change, Run, SyncMoment

#: Room for the last bits of differences of floating point numbers, as a fraction of a limit.
ROUNDING = 1e-6


@dataclass(frozen=True)
class Excess:
    """A cycle in which a limit was left: ``range``, ``velocity`` or ``acceleration``; `limit` is with the format's allowance."""

    index: int
    ipoc: int
    axis: str
    kind: str
    value: float
    limit: float

    def __str__(self) -> str:
        return f"entry {self.index}, IPOC {self.ipoc}: {self.axis} {self.kind} {self.value:.6g}; limit {self.limit:.6g}"


def trace_motion(entries: Sequence[TraceEntry], cycle: float) -> tuple[np.ndarray, np.ndarray]:
    """Return each reply's step from the last one that arrived, and its change from the step before, shape (k, n) [rad].

    A controller session begins at rest; so does what follows a cycle [s] without a reply, because HOLDON has stopped the arm.
    """
    steps, changes = [], []
    last = last_acknowledged = None
    step = rest = np.zeros(len(entries[0].position))
    for entry in entries:
        if last is None or entry.session != last.session:
            last, last_acknowledged, step = entry, None, rest
        elif entry.time_since(last) > round(cycle * 1000):
            step = rest
        if entry.lost and last_acknowledged is not None:
            last, step = last_acknowledged, rest
        new = np.subtract(entry.position, last.position)
        if entry.state in HELD:
            # the pose follows the controller's own motion: what it does, and what it does in a missed cycle, is not the gateway's
            new = step = rest
        steps.append(new)
        changes.append(new - step)
        last_acknowledged, last, step = last, entry, new
    return np.array(steps), np.array(changes)


def _arm_motion(positions: np.ndarray, breaks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the same of an arm's positions, one per cycle, shape (k, n) [rad]; where one `breaks`, a motion begins from rest."""
    steps = np.diff(positions, axis=0, prepend=positions[:1])
    steps[breaks] = 0.0
    before = np.vstack([np.zeros_like(steps[:1]), steps[:-1]])
    before[breaks] = 0.0
    return steps, steps - before


def _allowed(limits: MotionLimits, decimals: int, cycle: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest velocity and acceleration of each joint, with the allowance of the format's decimals."""
    allowance = np.array(limits.allowances(decimals, cycle))
    return np.array(limits.velocity) + allowance * cycle / 2, np.array(limits.acceleration) + allowance


def _limit_usage(
    steps: np.ndarray, changes: np.ndarray, limits: MotionLimits, decimals: int, cycle: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest velocity and acceleration of each joint as a fraction of what is allowed."""
    velocity, acceleration = _allowed(limits, decimals, cycle)
    return np.abs(steps).max(axis=0) / cycle / velocity, np.abs(changes).max(axis=0) / cycle**2 / acceleration


def trace_excesses(
    entries: Sequence[TraceEntry], limits: MotionLimits, decimals: int, cycle: float = CYCLE
) -> list[Excess]:
    """Return every place where a trace leaves the limits; empty when it stays inside.

    Args:
        decimals: Decimals on the wire; velocity and acceleration are allowed what their rounding adds.
        cycle: The controller's cycle [s].
    """
    if not entries:
        return []
    steps, changes = trace_motion(entries, cycle)
    velocity, acceleration = _allowed(limits, decimals, cycle)
    ranges = np.array(limits.lower), np.array(limits.upper)
    found = []
    for kind, values, (lower, upper), slack in (
        ("range", np.array([entry.position for entry in entries]), ranges, RANGE_SLACK),
        ("velocity", steps / cycle, (-velocity, velocity), velocity * ROUNDING),
        ("acceleration", changes / cycle**2, (-acceleration, acceleration), acceleration * ROUNDING),
    ):
        # written so that a nan is outside
        for index, axis in np.argwhere(~((values >= lower - slack) & (values <= upper + slack))).tolist():
            value = float(values[index, axis])
            limit = float((upper if value > upper[axis] else lower)[axis])
            found.append(Excess(index, entries[index].ipoc, limits.names[axis], kind, value, limit))
    return sorted(found, key=lambda excess: excess.index)


#: The arm holds somewhere else than at the goal when a joint is at least this far from it [deg].
ELSEWHERE_DEG = 1.0
#: Rounding of what is stated and measured [deg].
STATED_DEG = 1e-3
#: A missed reply stops the arm dead and lets it catch up: the arm's cycles before and after its report that are its own. Cycles and
#: not a time: a controller process that is late has its next cycles later.
_MISSED = 5
#: Room for what the last samples of a bag do not cover [ns].
_MARGIN = NANOSECONDS // 50


@dataclass(frozen=True)
class Check:
    """One comparison of what was found with what was expected."""

    name: str
    expected: str
    found: str
    passed: bool


@dataclass(frozen=True)
class Judgement:
    """The outcome of a run.

    `measured`: Figures for the table: ``did``, ``detection_s``, ``detection_samples``, ``worst_error_deg``, ``worst_joint``,
    ``velocity_fraction``, ``acceleration_fraction`` (of the corrections), ``arm_velocity_fraction``, ``arm_acceleration_fraction``
    (of the sound joints), ``missed_replies``, ``stop_distance_deg``, ``stop_time_s``; None where there is none.
    """

    scenario: str
    title: str
    checks: tuple[Check, ...]
    measured: dict

    @property
    def passed(self) -> bool:
        """True when every check is."""
        return all(check.passed for check in self.checks)

    def to_dict(self) -> dict:
        """Return what verdict.json holds."""
        return {"passed": self.passed, **asdict(self)}


def judge(
    scenario: Scenario, run: Run, trace: Sequence[TraceEntry], limits: MotionLimits, decimals: int, cycle: float
) -> Judgement:
    """Judge a run; `cycle`: the controller's cycle [s]: a reply, and a pose of the arm, in each."""
    expect = scenario.expect
    checks = [Check("carried out", "every step", run.failure or "every step", not run.failure), *_begun(scenario, run)]
    order = run.states("sync")
    checks.append(Check("states of the gate", " ".join(expect.sync), " ".join(order), matches(expect.sync, order)))
    for topic, value in expect.final.items():
        checks.append(Check(f"final {topic}", value, run.last(topic), run.last(topic) == value))
    checks.append(_end(scenario, run))
    measured: dict = {"did": describe(run), "missed_replies": run.missed}
    checks += _detection(scenario, run, measured)
    checks += _errors(scenario, run, measured)
    checks += _corrections(trace, limits, decimals, cycle, measured)
    checks += _arm(scenario, run, limits, decimals, cycle, measured)
    checks += _stop(scenario, run, cycle, measured)
    checks += _gateway_stops(scenario, run, limits)
    checks += _refusal(scenario, run)
    return Judgement(scenario.name, scenario.title, tuple(checks), measured)


def _refusal(scenario: Scenario, run: Run) -> list[Check]:
    """Check that an approval was refused for the expected reason."""
    wanted, change = scenario.expect.refused, run.first("refused")
    if wanted is None:
        return []
    found = "none" if change is None else change.reason
    return [Check("refused approval", wanted, found, change is not None and wanted in found)]


def _begun(scenario: Scenario, run: Run) -> list[Check]:
    """Check that the controller reported every fault as on."""
    checks = []
    injected = {step.inject.fault for step in scenario.steps if step.inject and not step.inject.end}
    wanted = {name for name in injected if KINDS[name].lasting}
    if wanted:
        begun = {change.value for change in run.changes if change.topic == "fault"}
        found = ", ".join(sorted(begun)) or "none"
        checks.append(Check("faults that were on", ", ".join(sorted(wanted)), found, wanted <= begun))
    least = scenario.expect.min_missed
    if least is not None:
        checks.append(Check("missed replies", f"at least {least}", str(run.missed), run.missed >= least))
    return checks


def describe(run: Run) -> str:
    """Return a run in one line: the gate's states, the plan's outcome, the link's states."""
    parts = [" → ".join(run.states("sync")), "plan " + (run.last("outcome") or "not ended")]
    links = run.states("link")
    if len(links) > 1:
        parts.append("link " + " → ".join(links))
    return "; ".join(parts)


def matches(expected: Sequence[str], found: Sequence[str]) -> bool:
    """Return whether states came in this order; one that ends in ``?`` may be left out."""
    if not expected:
        return not found
    head, rest = expected[0], expected[1:]
    if found and found[0] == head.rstrip("?") and matches(rest, found[1:]):
        return True
    return head.endswith("?") and matches(rest, found)


def _end(scenario: Scenario, run: Run) -> Check:
    away = np.degrees(np.abs(run.arm[-1] - np.array(radians(scenario.goal_deg)))).max() if scenario.goal_deg else 0.0
    found = f"{away:.6f} deg from the goal"
    if scenario.expect.ends == "goal":
        bound = scenario.expect.final_error_deg
        return Check("ends at the goal", f"within {bound:g} deg", found, bool(away <= bound))
    return Check("holds before the goal", f"at least {ELSEWHERE_DEG:g} deg from it", found, bool(away >= ELSEWHERE_DEG))


def _fault(scenario: Scenario, run: Run) -> Change | None:
    """Return the first fault that began; in a scenario without faults, the first call of a person."""
    return run.first("fault") or (None if any(step.inject for step in scenario.steps) else run.first("call"))


def _detection(scenario: Scenario, run: Run, measured: dict) -> list[Check]:
    """Check how soon the gate closed: from the fault, and in samples from the first one over the threshold."""
    fault = _fault(scenario, run)
    closing = next((c for c in run.closings if fault is not None and c.stamp >= max(fault.stamp, run.start)), None)
    seconds: float | None = None
    samples: int | None = None
    checks = []
    if fault is not None and closing is not None:
        seconds = (closing.stamp - fault.stamp) / NANOSECONDS
        crossing = _crossing(run, closing, fault.stamp)
        if crossing is not None:
            samples = crossing.samples
            if fault.value == "stall":
                injections = [step.inject for step in scenario.steps if step.inject]
                stalled = next(injection.joint for injection in injections if injection.fault == "stall")
                checks.append(_growth(run, closing, crossing, stalled))
    measured |= {"detection_s": seconds, "detection_samples": samples}
    for name, bound, found in (
        ("detection_s", scenario.expect.detection_s, seconds),
        ("detection_samples", scenario.expect.detection_samples, samples),
    ):
        if bound is not None:
            text = "not detected" if found is None else f"{found:g}"
            checks.append(Check(name, f"at most {bound:g}", text, found is not None and found <= bound))
    return checks


@dataclass(frozen=True)
class _Crossing:
    """How a joint's error went over its threshold.

    `last_agreed_stamp`: of the command that the last sample within it was compared with; `last`: of the recording's end [ns].
    """

    joint: int
    samples: int
    last_agreed_stamp: int
    last: int


def _crossing(run: Run, closing: SyncMoment, begin: int) -> _Crossing | None:
    """Return how the error that closed the gate grew; None when it closed for another reason."""
    if not closing.error or run.recording.feedback is None:
        return None
    fractions = [error / threshold for error, threshold in zip(closing.error, closing.threshold)]
    joint = fractions.index(max(fractions))
    if fractions[joint] <= 1.0:
        return None
    aligned = align_lag_removed(
        run.recording, Window(min(begin, run.start), closing.stamp, closing.stamp, False), _lag_ns(closing)
    )
    if aligned is None:
        return None
    column = run.recording.joint_names.index(closing.joints[joint])
    over = np.abs(aligned.errors[:, column]) > closing.threshold[joint]
    within = np.flatnonzero(~over)
    first = int(within[-1]) + 1 if len(within) else 0
    feedback = run.recording.feedback
    sample = np.searchsorted(feedback.stamps, aligned.stamps[max(0, first - 1)])
    return _Crossing(
        joint=column,
        samples=len(over) - first,
        last_agreed_stamp=int(feedback.command_stamps[sample] - _lag_ns(closing)),
        last=int(feedback.stamps[-1]),
    )


def _lag_ns(closing: SyncMoment) -> float:
    return 0.0 if math.isnan(closing.servo_lag) else closing.servo_lag * NANOSECONDS


def _growth(run: Run, closing: SyncMoment, crossing: _Crossing, stalled: str) -> Check:
    """Check that a stalled joint's error grew only while its feedback and earlier commands travelled.

    From the command of the last sample within the threshold until the gate closed it grows at most at the joint's speed.
    """
    joint = crossing.joint
    name = run.recording.joint_names[joint]
    if name != stalled:
        return Check("error of the stalled joint", f"the gate to close for {stalled}", f"it closed for {name}", False)
    threshold = closing.threshold[closing.joints.index(name)]
    twin = run.recording.twin
    under_way = (twin.stamps >= crossing.last_agreed_stamp - CYCLE_NS) & (twin.stamps <= closing.stamp)
    # by the stamps: where the recording lost a message, two cycles lie between
    speeds = np.abs(np.diff(twin.positions[under_way, joint])) / np.diff(twin.stamps[under_way]) * NANOSECONDS
    speed = float(speeds.max(initial=0.0))
    delay = (closing.stamp - crossing.last_agreed_stamp) / NANOSECONDS
    released = run.first("fault_end", since=closing.stamp)
    end = released.stamp if released else crossing.last
    aligned = align_lag_removed(run.recording, Window(crossing.last_agreed_stamp, end, end, False), _lag_ns(closing))
    if aligned is None:
        return Check("error of the stalled joint", "poses after it stalled", "none that can be compared", False)
    worst = float(np.abs(aligned.errors[:, joint]).max())
    bound = threshold + speed * delay
    parts = f"{math.degrees(threshold):.3f} deg and {delay * 1e3:.1f} ms at {math.degrees(speed):.1f} deg/s"
    expected = f"at most {math.degrees(bound):.3f} deg ({parts})"
    return Check("error of the stalled joint", expected, f"{math.degrees(worst):.3f} deg", worst <= bound)


def _errors(scenario: Scenario, run: Run, measured: dict) -> list[Check]:
    worst = _worst_errors(run)
    joint = int(np.argmax(worst))
    measured |= {"worst_error_deg": float(worst[joint]), "worst_joint": run.recording.joint_names[joint]}
    bound = scenario.expect.max_error_deg
    if bound is None:
        return []
    found = f"{worst[joint]:.4f} deg at {run.recording.joint_names[joint]}"
    return [Check("largest error", f"at most {bound:g} deg", found, bool(worst[joint] <= bound))]


def _worst_errors(run: Run) -> np.ndarray:
    """Return the largest error per joint since the start of the motion, shape (n,) [deg]."""
    recording = run.recording
    window = Window(run.start, int(recording.twin.stamps.max()) - _MARGIN, run.start, False)
    worst = np.zeros(len(recording.joint_names))
    aligned = align_by_command(recording, window)
    if aligned is not None:
        worst = aligned.maximum
    feedback = recording.feedback
    if feedback is None:
        return np.degrees(worst)
    # without a command stamp: against the twin's pose at that time
    present = window.contains(feedback.stamps) & (feedback.command_stamps == 0)
    if present.any():
        path = TwinPath(recording.twin, window.start)
        times = (feedback.stamps[present] - window.start).astype(float)
        covered = path.covers(times)
        if covered.any():
            errors = np.abs(feedback.positions[present][covered] - path(times[covered]))
            worst = np.maximum(worst, errors.max(axis=0))
    return np.degrees(worst)


def _corrections(
    trace: Sequence[TraceEntry], limits: MotionLimits, decimals: int, cycle: float, measured: dict
) -> list[Check]:
    if not trace:
        return [Check("corrections inside the limits", "a trace of the gateway", "an empty one", False)]
    excesses = trace_excesses(trace, limits, decimals, cycle)
    velocity, acceleration = _limit_usage(*trace_motion(trace, cycle), limits, decimals, cycle)
    measured |= {"velocity_fraction": float(velocity.max()), "acceleration_fraction": float(acceleration.max())}
    found = "; ".join(map(str, excesses[:3])) or f"{len(trace)} replies inside"
    return [Check("corrections inside the limits", "every reply", found, not excesses)]


def _arm(
    scenario: Scenario, run: Run, limits: MotionLimits, decimals: int, cycle: float, measured: dict
) -> list[Check]:
    """Check the motion of the sound joints; cycles of a missed reply, which stops the arm dead, are only reported."""
    names = [name for name in limits.names if name not in scenario.faulted]
    if not names:
        measured |= {"arm_velocity_fraction": None, "arm_acceleration_fraction": None}
        return []
    breaks = np.zeros(len(run.arm), dtype=bool)
    breaks[0] = True
    for change in run.changes:
        if change.topic == "session":
            # the report of a new session is made in its first cycle
            near = np.abs(run.arm_stamps - change.stamp).argmin()
            breaks[max(0, near - 1) : near + 2] = True
    steps, changes = _arm_motion(run.arm, breaks)
    velocity, acceleration = _limit_usage(steps, changes, limits, decimals, cycle)
    columns = [limits.names.index(name) for name in names]
    v, a = float(velocity[columns].max()), float(acceleration[columns].max())
    measured |= {"arm_velocity_fraction": v, "arm_acceleration_fraction": a}
    for at in np.searchsorted(run.arm_stamps, run.missed_at):
        around = slice(max(0, at - _MISSED), at + _MISSED + 1)
        steps[around] = changes[around] = 0.0
    others = [float(fraction[columns].max()) for fraction in _limit_usage(steps, changes, limits, decimals, cycle)]
    found = f"velocity {others[0]:.3f}, acceleration {others[1]:.3f} of the limits beside {run.missed} missed replies"
    return [Check("sound joints inside the limits", "at most 1", found, max(others) <= 1.0 + ROUNDING)]


def _gateway_stops(scenario: Scenario, run: Run, limits: MotionLimits) -> list[Check]:
    """Check that no sound joint goes further than the gateway stated when it began to brake."""
    sound = [index for index, name in enumerate(limits.names) if name not in scenario.faulted]
    checks = []
    for stop in run.stops:
        further = max((stop.moved[index] - stop.stated[index] for index in sound), default=0.0)
        expected = f"no joint further than the gateway stated, {max(stop.stated):.4f} deg for the one that moves most"
        checks.append(Check(f"distance after {stop.cause}", expected, f"{further:+.4f} deg", further <= STATED_DEG))
    return checks


def _stop(scenario: Scenario, run: Run, cycle: float, measured: dict) -> list[Check]:
    bound = scenario.expect.stop
    measured |= {"stop_distance_deg": None, "stop_time_s": None}
    if bound is None:
        return []
    topic, value = bound.event.split(" ", 1)
    event = run.first(topic, value, since=run.start)
    expected = f"at most {bound.distance_deg:g} deg after {bound.event}"
    if event is None:
        return [Check("stop distance", expected, "no such event", False)]
    released = [
        c.stamp
        for c in run.changes
        if c.stamp > event.stamp
        and ((c.topic, c.value) == ("execution", "PLAYING") or c.topic in ("call", "move", "fault_end"))
    ]
    begin = event.stamp
    if event.value == "restart_at":
        # the new session stands elsewhere from its first cycle on: that is no motion
        session = run.first("session", since=begin - NANOSECONDS // 10)
        begin = session.stamp + round(cycle * NANOSECONDS) if session else begin
    distance, rest = _distance_after(run.arm_stamps, run.arm, begin, min(released, default=int(run.arm_stamps[-1])))
    largest = float(np.degrees(distance).max())
    measured |= {"stop_distance_deg": largest, "stop_time_s": rest}
    found = f"{largest:.4f} deg, at rest after {rest:.3f} s"
    checks = [Check("stop distance", expected, found, largest <= bound.distance_deg)]
    if event.topic == "fault" and run.stated:
        further = float((np.degrees(distance) - np.abs(run.stated)).max())
        most = max(map(abs, run.stated))
        stated = f"no joint further than the controller stated, {most:.4f} deg for the one that moves most"
        checks.append(Check("stated stop distance", stated, f"{further:+.4f} deg", further <= STATED_DEG))
    return checks


def _distance_after(stamps: np.ndarray, positions: np.ndarray, begin: int, end: int) -> tuple[np.ndarray, float]:
    """Return the largest distance of each joint from its position at `begin`, until `end`, and the time to the arm's rest [s].

    Args:
        stamps: Shape (k,). [ns]
        positions: Shape (k, n). [rad]
        begin, end: [ns]
    """
    # from the cycle before: by its number, because a controller process that was late sends the next ones sooner
    first = max(0, int(np.searchsorted(stamps, begin)) - 1)
    inside = np.arange(first, int(np.searchsorted(stamps, end, side="right")))
    if not len(inside):
        return np.zeros(positions.shape[1]), 0.0
    part = positions[inside]
    moved = np.flatnonzero(np.abs(np.diff(part, axis=0)).max(axis=1, initial=0.0) > 1e-9)
    rest = max(0.0, (stamps[inside[moved[-1] + 1]] - begin) / NANOSECONDS) if len(moved) else 0.0
    return np.abs(part - part[0]).max(axis=0), float(rest)
