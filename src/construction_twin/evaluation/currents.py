"""Compares the motor currents of a run with those of a reference run of the same plan.

The two are aligned by where the arm is on the plan, never by a clock: the executor's setpoints say, one by one, at which time of
the plan it was, and a current names the command, which has the stamp of its setpoint. So a pause, a hold or a speed limit moves
nothing. How much current a motion takes depends on its speed: currents of where the two runs were not equally fast are counted and
left out, as are those within 0.2 s of one. SI; currents in the unit in which the controller tells them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.pace import PACE, STEADY
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import CYCLE, NANOSECONDS
from construction_twin.evaluation.recording import PlayedPlan, Recording, Stream
from construction_twin.robot.plan import Plan
from construction_twin.robot.trajectory import Trajectory

#: A setpoint that is further from the plan than this is none of it [rad], [m]. It is told exactly.
OFF_PATH = 1e-7
#: A command that is further from its setpoint than this is another pose, held by the gate [rad], [m]: it is told with its decimals.
OTHER = 1e-3
#: How far back on the plan the arm may go on after a hold [s].
BACK = 2.0
#: Between two currents of the reference that are further apart on the plan than this, nothing is known of it [s].
GAP = 5 * CYCLE
#: So close to the end of a plan the arm has arrived [s].
ARRIVED = 1e-6
#: Fewer currents are no comparison, but what two runs of another pace have in common before the arm is fast: 0.2 s.
LEAST = 50
#: Most steps of a search for a setpoint, the length of one that ends it [s], and the distance that only rounding makes [rad], [m].
STEPS, CLOSE, ROUNDING = 12, 1e-12, 1e-14


@dataclass(frozen=True)
class CurrentRun:
    """The currents of one execution of a plan.

    Attributes:
        name: Of the recording, for people.
        plan: What was executed; `joint_names` are those of its trajectory.
        times: Shape (m,). Where on the plan each was told, not decreasing but for rounding [s].
        pace: Shape (m,). The fraction of the planned speed there, 0 to 1.
        stamps: Shape (m,), int64. Of the commands that they belong to [ns].
        values: Shape (m, n). nan for an axis of which none are told.
        unsteady: Currents of this execution that name no command, because the arm did not move exactly as commanded.
    """

    name: str
    plan: Plan
    times: np.ndarray
    pace: np.ndarray
    stamps: np.ndarray
    values: np.ndarray
    unsteady: int


@dataclass(frozen=True)
class AxisDifference:
    """How much one axis differs from the reference; None where none are told, or nothing was compared.

    Attributes:
        largest: The largest difference, measured less reference, with its sign.
        rms: Root mean square of the differences.
        reference_rms: Of the reference's currents at the same setpoints.
        time: Where the largest is, from the beginning of the plan [s].
        setpoint: The number of the setpoint there, of 4 ms each, from 0.
        position: Of the joint there [rad], [m].
        reference, measured: The two currents there.
    """

    joint: str
    largest: float | None = None
    rms: float | None = None
    reference_rms: float | None = None
    time: float | None = None
    setpoint: int | None = None
    position: float | None = None
    reference: float | None = None
    measured: float | None = None


@dataclass(frozen=True)
class CurrentComparison:
    """Two runs of one plan beside each other.

    Attributes:
        reference, measured: Names of the recordings.
        axes: In the plan's order.
        times: Shape (m,). Where on the plan currents were compared, from its beginning [s].
        reference_values, measured_values: Shape (m, n).
        compared: m.
        other_pace: Currents of where the two runs were not equally fast, and those within 0.2 s of them; not compared.
        no_reference: Currents of where the reference holds none.
        unsteady: See `CurrentRun`; of the run that is compared.
    """

    reference: str
    measured: str
    plan: Plan
    axes: tuple[AxisDifference, ...]
    times: np.ndarray
    reference_values: np.ndarray
    measured_values: np.ndarray
    other_pace: int
    no_reference: int
    unsteady: int

    @property
    def compared(self) -> int:
        """How many currents were compared."""
        return len(self.times)

    @property
    def worst(self) -> AxisDifference | None:
        """The axis with the largest difference; None where no currents are told."""
        told = [axis for axis in self.axes if axis.largest is not None]
        return max(told, key=lambda axis: abs(axis.largest or 0.0)) if told else None


def runs_of(name: str, recording: Recording, plans: Sequence[Plan]) -> list[CurrentRun]:
    """Return the executions in a recording whose currents are known, the newest first.

    Args:
        name: Of the recording, for people.
        plans: Those that it holds.

    Raises:
        ConstructionTwinError: If it holds no currents, no commands, no execution of one of the plans, or none with currents.
    """
    currents, command, setpoints = recording.currents, recording.command, recording.setpoints
    if currents is None or not np.isfinite(currents.values).any():
        raise ConstructionTwinError(Sentence("view.currents.none", name=name))
    if command is None or setpoints is None:
        raise ConstructionTwinError(Sentence("view.currents.no_setpoints", name=name))
    by_id = {plan.id: plan for plan in plans if set(plan.trajectory.joint_names) <= set(recording.joint_names)}
    begin = int(setpoints.stamps.min())
    played = [each for each in recording.plans if each.plan_id in by_id and each.start >= begin]
    ends = [each.start for each in played[1:]] + [int(setpoints.stamps.max()) + 1]
    found = [_run(name, recording, by_id[each.plan_id], each, end) for each, end in zip(played, ends)]
    runs = [run for run in reversed(found) if len(run.times)]
    if not runs:
        raise ConstructionTwinError(Sentence("view.currents.not_played", name=name))
    return runs


def _steady(stamps: np.ndarray, differs: np.ndarray) -> np.ndarray:
    """Return which stamps are further than `STEADY` from every one at which something differs, shape (m,), bool."""
    far = np.iinfo(np.int64).max // 2
    last = np.maximum.accumulate(np.where(differs, stamps, -far))
    # a ramp begins and ends softly: before the pace differs enough to be seen the torques do
    coming = np.minimum.accumulate(np.where(differs, stamps, far)[::-1])[::-1]
    return (stamps - last >= STEADY) & (coming - stamps >= STEADY)


def same_plan(reference: Sequence[CurrentRun], runs: Sequence[CurrentRun]) -> tuple[CurrentRun, CurrentRun]:
    """Return the newest run of which the reference holds one of the same plan, by its hash, and that one before it.

    Raises:
        ConstructionTwinError: If no plan is in both.
    """
    for run in runs:
        for known in reference:
            if known.plan.hash == run.plan.hash:
                return known, run
    hashes = [", ".join(dict.fromkeys(each.plan.hash[:12] for each in side)) for side in (reference, runs)]
    names = {"reference": reference[0].name, "name": runs[0].name}
    raise ConstructionTwinError(Sentence("view.currents.other_plan", **names, known=hashes[0], found=hashes[1]))


def compare_currents(reference: CurrentRun, run: CurrentRun, any_pace: bool = False) -> CurrentComparison:
    """Compare a run with a reference run of the same plan.

    Args:
        any_pace: Also compare where the two were not equally fast.

    Raises:
        ConstructionTwinError: If there are not enough currents that can be compared.
    """
    rising = np.concatenate([[True], reference.times[1:] > np.maximum.accumulate(reference.times)[:-1]])
    known = reference.times[rising]
    after = np.searchsorted(known, run.times)
    right, left = np.minimum(after, len(known) - 1), np.maximum(after - 1, 0)
    left = np.where(known[right] == run.times, right, left)
    covered = (known[left] <= run.times) & (run.times <= known[right]) & (known[right] - known[left] <= GAP)
    weight = (run.times - known[left]) / np.where(right > left, known[right] - known[left], 1.0)

    def at_run(values: np.ndarray) -> np.ndarray:
        fraction = weight.reshape(-1, *[1] * (values.ndim - 1))
        # the one itself where it stands there: what is not told of its neighbour does not matter
        return np.where(fraction == 0.0, values[left], (1.0 - fraction) * values[left] + fraction * values[right])

    pace = at_run(reference.pace[rising])
    differs = ~covered | (np.abs(run.pace - pace) > pace / PACE) | (run.pace <= 0.0)
    taken = covered & ((_steady(run.stamps, differs & covered) & ~differs) | any_pace)
    if np.count_nonzero(taken) < LEAST:
        names = {"reference": reference.name, "name": run.name}
        raise ConstructionTwinError(Sentence("view.currents.nothing", **names))
    times, expected, measured = run.times[taken], at_run(reference.values[rising])[taken], run.values[taken]
    positions = run.plan.trajectory.sample_many(times)[0]
    axes = [
        _axis(joint, times, expected[:, column], measured[:, column], positions[:, column])
        for column, joint in enumerate(run.plan.trajectory.joint_names)
    ]
    return CurrentComparison(
        reference.name, run.name, run.plan, tuple(axes), times, expected, measured,
        other_pace=int(np.count_nonzero(covered & ~taken)), no_reference=int(np.count_nonzero(~covered)),
        unsteady=run.unsteady,
    )  # fmt: skip


def elapsed_along(trajectory: Trajectory, setpoints: Stream) -> np.ndarray:
    """Return at which time of a plan each setpoint is, shape (k,) [s]; nan for one that is not on its path.

    Setpoints go along the plan, no faster than planned, may rest on it, and after a hold go on where the arm is. Where the plan
    itself rests, the time goes on as planned: all its setpoints there are the same.

    Args:
        setpoints: From the plan's first one on, with the joints of the trajectory.
    """
    elapsed, at = np.full(len(setpoints), np.nan), 0.0
    periods = np.diff(setpoints.stamps, prepend=setpoints.stamps[:1]) / NANOSECONDS
    for row, (goal, period) in enumerate(zip(setpoints.positions, periods.tolist())):
        found, distance = _nearest(trajectory, goal, at, period)
        if distance > OFF_PATH:
            grid = np.arange(max(at - BACK, 0.0), at + CYCLE, CYCLE)
            near = np.abs(trajectory.sample_many(grid)[0] - goal).max(axis=1)
            found, distance = _nearest(trajectory, goal, float(grid[np.argmin(near)]), CYCLE)
        if distance <= OFF_PATH:
            elapsed[row] = at = found
    return elapsed


def _nearest(trajectory: Trajectory, goal: np.ndarray, at: float, period: float) -> tuple[float, float]:
    """Return the time on a trajectory at which it is nearest to a pose [s], and the distance of the joint that is furthest.

    Args:
        at: Where it was a `period` before [s]. Where the trajectory rests it goes on from there as planned.
    """
    # a little further than planned, to make up for where it rests and the time is not known to the last bit
    low, high = max(at - period, 0.0), min(at + period * (1.0 + 1.0 / PACE), trajectory.duration)
    time = min(at + period, high)
    for _ in range(STEPS):
        position, velocity, _ = trajectory.sample(time)
        away, square = goal - position, float(velocity @ velocity)
        if np.abs(away).max() <= ROUNDING:
            break
        moved = min(max(time + float(away @ velocity) / square, low), high) if square else time
        if abs(moved - time) < CLOSE:
            break
        time = moved
    return time, float(np.abs(away).max())


def _run(name: str, recording: Recording, plan: Plan, played: PlayedPlan, end: int) -> CurrentRun:
    currents, command, played_setpoints = recording.currents, recording.command, recording.setpoints
    assert currents is not None and command is not None and played_setpoints is not None
    columns = [recording.joint_names.index(joint) for joint in plan.trajectory.joint_names]
    stamps = played_setpoints.stamps
    newest = np.concatenate([[True], stamps[1:] > np.maximum.accumulate(stamps)[:-1]])
    mine = newest & (stamps >= played.start) & (stamps < end)
    setpoints = Stream(stamps[mine], played_setpoints.positions[mine][:, columns], played_setpoints.received[mine])
    times = elapsed_along(plan.trajectory, setpoints)
    # what the gate held back is no place of the arm on the plan
    _, rows, others = np.intersect1d(setpoints.stamps, command.stamps, return_indices=True)
    passed = np.zeros(len(times), bool)
    passed[rows] = np.abs(setpoints.positions[rows] - command.positions[others][:, columns]).max(axis=1) <= OTHER
    times[~passed] = np.nan
    # the step to its end may be shorter than a cycle, which is no other pace; what follows is rest
    arrived = np.flatnonzero(times >= plan.trajectory.duration - ARRIVED)
    last = int(arrived[0]) if len(arrived) else len(times)
    stamps, times = setpoints.stamps[:last], times[:last]
    told = currents.command_stamps
    before = np.clip(np.searchsorted(stamps, told, side="right") - 1, 0, max(len(stamps) - 2, 0))
    inside = np.zeros(len(told), bool)
    if len(stamps) > 1:
        inside = (told >= stamps[0]) & (told <= stamps[-1]) & np.isfinite(times[before] + times[before + 1])
    before = before[inside]
    period, step = np.diff(stamps)[before], np.diff(times)[before]
    fraction = (told[inside] - stamps[before]) / period
    # what names no command is of this execution from its first current on, until one names a later command
    first = int(np.argmax(inside)) if inside.any() else len(told)
    later = np.flatnonzero(told[first:] > stamps[-1])
    past = first + int(later[0]) if len(later) else len(told)
    return CurrentRun(
        name, plan, times[before] + fraction * step, step * NANOSECONDS / period, told[inside],
        currents.values[inside][:, columns], int(np.count_nonzero(told[first:past] == 0)),
    )  # fmt: skip


def _axis(
    joint: str, times: np.ndarray, reference: np.ndarray, measured: np.ndarray, positions: np.ndarray
) -> AxisDifference:
    difference = measured - reference
    told = np.isfinite(difference)
    if not told.any():
        return AxisDifference(joint)
    row = int(np.argmax(np.where(told, np.abs(difference), -1.0)))
    return AxisDifference(
        joint, float(difference[row]), _rms(difference[told]), _rms(reference[told]), float(times[row]),
        round(float(times[row]) / CYCLE), float(positions[row]), float(reference[row]), float(measured[row]),
    )  # fmt: skip


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def summary_of(comparison: CurrentComparison) -> Mapping:
    """Return what `currents.json` holds, ready for `json.dumps`."""
    return {
        "reference": comparison.reference,
        "recording": comparison.measured,
        "plan": {
            "id": comparison.plan.id,
            "hash": comparison.plan.hash,
            "duration_s": comparison.plan.trajectory.duration,
        },
        "currents": {
            "compared": comparison.compared,
            "other_pace": comparison.other_pace,
            "no_reference": comparison.no_reference,
            "not_as_commanded": comparison.unsteady,
        },
        "axes": [axis_document(axis) for axis in comparison.axes],
    }


def axis_document(axis: AxisDifference) -> dict[str, str | float | int | None]:
    """Return one axis as the files hold it: the columns of `currents.csv`, in order."""
    return {
        "joint": axis.joint,
        "largest": axis.largest,
        "rms": axis.rms,
        "reference_rms": axis.reference_rms,
        "time_s": axis.time,
        "setpoint": axis.setpoint,
        "position": axis.position,
        "reference": axis.reference,
        "measured": axis.measured,
    }
