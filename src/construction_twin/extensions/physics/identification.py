"""A servo's model from a recording: what targets the controller took, and where the arm was.

A joint's model begins with frequency and damping. Delay, feed-forward and backlash are added one by one, while the Bayesian
information criterion falls; a parameter that is left out is 0. Angles in rad, prismatic joints in m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import yaml
from scipy.optimize import approx_fprime, least_squares
from scipy.signal import lfilter

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.units import NANOSECONDS
from construction_twin.servo.model import JointServo

#: What a joint must have done at least: travelled [rad], at this speed [rad/s], in motion for so many samples.
TRAVEL, SPEED, SAMPLES = 0.05, 0.1, 250
#: A lag that is not known better than this was not excited [s]: one standard deviation.
LAG_ERROR = 0.001
#: What may be taken in beyond frequency and damping, with the values it is begun with, its scale, and its bounds.
_OPTIONS = {
    "delay": (0.5, 1.0, 0.0, 12.0),
    "velocity": (0.0, 0.01, -0.2, 0.2),
    "acceleration": (0.0, 1e-4, -0.02, 0.02),
    "backlash": (2e-4, 1e-3, 0.0, 0.05),
}
#: One more parameter must lower the sum of squares by so much, whatever the criterion says of many samples.
_GAIN = 0.02
NO_MOTION = "the recording holds no motion that begins at rest and answers commands as they were given"
#: First guesses of frequency [rad/s].
_GUESSES = (25.0, 60.0, 150.0)


@dataclass(frozen=True)
class RecordedMotion:
    """A recorded motion without a gap, from rest: one row per cycle.

    Attributes:
        targets, measured: Shape (m, n). What the controller took, and where the arm was at the end of the cycle [rad].
        counts: Shape (m,). Rows that may be judged: the others only drive.
    """

    targets: np.ndarray
    measured: np.ndarray
    counts: np.ndarray


@dataclass(frozen=True)
class IdentifiedJoint:
    """An identified joint.

    Attributes:
        lag_error: Standard deviation of its lag [s].
        deviations: Standard deviation of each fitted parameter, in its unit.
        residual_rms, residual_max: Measured minus model [rad], [m].
    """

    name: str
    servo: JointServo
    lag_error: float
    deviations: dict[str, float]
    residual_rms: float
    residual_max: float


def identify(names: Sequence[str], drives: Sequence[RecordedMotion], cycle_ns: int) -> tuple[IdentifiedJoint, ...]:
    """Find the servo of every joint; `cycle_ns`: of the controller [ns]."""
    if not drives or not sum(int(drive.counts.sum()) for drive in drives):
        raise ConstructionTwinError(NO_MOTION)
    period = cycle_ns / NANOSECONDS
    still = [name for joint, name in enumerate(names) if not _excited(drives, joint, period)]
    if still:
        raise ConstructionTwinError(
            f"the recording does not excite {', '.join(still)}: each joint must travel {TRAVEL:g} rad (m) "
            f"at {SPEED:g} rad/s (m/s) or more"
        )
    found = tuple(_Fit(drives, joint, period).joint(name) for joint, name in enumerate(names))
    unsure = [each.name for each in found if not each.lag_error <= LAG_ERROR]
    if unsure:
        raise ConstructionTwinError(
            f"the lag of {', '.join(unsure)} is not known to {LAG_ERROR * 1e3:g} ms: record more and "
            "quicker motion of each joint"
        )
    return found


def response(servo: JointServo, targets: np.ndarray, period: float) -> np.ndarray:
    """Return where a servo has its joint at the end of each cycle, shape (m,), from rest at the first target.

    What `model.ServoState` does step by step.
    """
    start = targets[0]
    offset = targets - start
    before, earlier = _shifted(offset, 1), _shifted(offset, 2)
    reference = (
        offset
        + servo.velocity / period * (offset - before)
        + servo.acceleration / period**2 * (offset - 2.0 * before + earlier)
    )
    whole, first, second = servo.parts(period)
    one, two = np.array(first), np.array(second)
    step = two @ one
    by_old, by_new = two @ (np.eye(2) - one)[:, 0], (np.eye(2) - two)[:, 0]
    trace, determinant = np.trace(step), np.linalg.det(step)
    adjugate = trace * np.eye(2) - step
    denominator = [1.0, -trace, determinant]
    x = lfilter([by_new[0], -(adjugate @ by_new)[0]], denominator, _shifted(reference, whole))
    x = x + lfilter([by_old[0], -(adjugate @ by_old)[0]], denominator, _shifted(reference, whole + 1))
    return start + (_with_backlash(x, servo.backlash / 2.0) if servo.backlash else x)


def _shifted(values: np.ndarray, cycles: int) -> np.ndarray:
    return np.concatenate([np.zeros(min(cycles, len(values))), values[: max(0, len(values) - cycles)]])


def _with_backlash(x: np.ndarray, play: float) -> np.ndarray:
    out, position = [], 0.0
    for value in x.tolist():
        position = min(max(position, value - play), value + play)
        out.append(position)
    return np.array(out)


def _moving(drive: RecordedMotion, joint: int, period: float) -> np.ndarray:
    """Return which judged rows are in motion, or less than 0.2 s after it, shape (m,)."""
    speed = np.abs(np.diff(drive.targets[:, joint], prepend=drive.targets[0, joint])) / period
    recent = np.convolve(speed > SPEED / 10.0, np.ones(round(0.2 / period)))[: len(speed)] > 0
    return drive.counts & recent


def _excited(drives: Sequence[RecordedMotion], joint: int, period: float) -> bool:
    travel = speed = 0.0
    samples = 0
    for drive in drives:
        targets = drive.targets[drive.counts, joint]
        if len(targets):
            travel = max(travel, float(np.ptp(targets)))
            steps = np.abs(np.diff(drive.targets[:, joint], prepend=drive.targets[0, joint]))[drive.counts]
            speed = max(speed, float(np.max(steps)) / period)
        samples += int(_moving(drive, joint, period).sum())
    return travel >= TRAVEL and speed >= SPEED and samples >= SAMPLES


class _Fit:
    """The fit of one joint."""

    def __init__(self, drives: Sequence[RecordedMotion], joint: int, period: float):
        self._period = period
        self._drives = [(drive.targets[:, joint], drive.measured[:, joint]) for drive in drives]
        self._rows = [_moving(drive, joint, period) for drive in drives]
        self._count = sum(int(rows.sum()) for rows in self._rows)

    def joint(self, name: str) -> IdentifiedJoint:
        """Return the servo with the options that improve the fit enough."""
        starts = [JointServo(guess, 0.8) for guess in _GUESSES]
        servo, cost = min((self._solve(start, ()) for start in starts), key=lambda found: found[1])
        options: tuple[str, ...] = ()
        while len(options) < len(_OPTIONS):
            tried = {option: self._with_option(servo, options, option) for option in _OPTIONS if option not in options}
            option = min(tried, key=lambda each: tried[each][1])
            best_servo, best_cost = tried[option]
            bic_change = self._count * np.log(max(best_cost, 1e-300) / cost) + np.log(self._count)
            if not (bic_change < 0.0 and best_cost < cost * (1.0 - _GAIN)):
                break
            servo, cost, options = best_servo, best_cost, (*options, option)
        return self._with_deviations(name, servo, options)

    def _with_option(self, servo: JointServo, options: tuple[str, ...], option: str) -> tuple[JointServo, float]:
        return self._solve(replace(servo, **{option: _OPTIONS[option][0]}), (*options, option))

    def _residuals(self, servo: JointServo) -> np.ndarray:
        return np.concatenate(
            [
                (measured - response(servo, targets, self._period))[rows]
                for (targets, measured), rows in zip(self._drives, self._rows)
            ]
        )

    def _solve(self, start: JointServo, options: tuple[str, ...]) -> tuple[JointServo, float]:
        """Return the best servo near `start`, and its sum of squares."""
        lower = [np.log(2.0), np.log(0.05), *(_OPTIONS[each][2] / _OPTIONS[each][1] for each in options)]
        upper = [np.log(2000.0), np.log(10.0), *(_OPTIONS[each][3] / _OPTIONS[each][1] for each in options)]
        values = np.clip(_values(start, options), np.array(lower) + 1e-9, np.array(upper) - 1e-9)
        found = least_squares(
            lambda each: self._residuals(_servo(each, options)) * 1e4, values, bounds=(lower, upper), max_nfev=60
        )
        return _servo(found.x, options), 2.0 * float(found.cost) * 1e-8

    def _with_deviations(self, name: str, servo: JointServo, options: tuple[str, ...]) -> IdentifiedJoint:
        values, residuals = _values(servo, options), self._residuals(servo)
        jacobian = approx_fprime(values, lambda each: self._residuals(_servo(each, options)), 1e-4)
        slope = approx_fprime(values, lambda each: _servo(each, options).lag(self._period), 1e-4)
        rms = float(np.sqrt(np.mean(residuals**2)))
        # neighbouring samples err alike: their noise is rounding, and what the model lacks; counted as one in ten
        covariance = np.linalg.pinv(jacobian.T @ jacobian) * 10.0 * rms**2
        scales = [servo.omega, servo.zeta, *(_OPTIONS[each][1] for each in options)]
        spread = np.sqrt(np.maximum(np.diag(covariance), 0.0)) * scales
        return IdentifiedJoint(
            name,
            servo,
            float(np.sqrt(max(slope @ covariance @ slope, 0.0))),
            dict(zip(("omega", "zeta", *options), spread.tolist())),
            rms,
            float(np.abs(residuals).max()),
        )


def _values(servo: JointServo, options: tuple[str, ...]) -> np.ndarray:
    others = [getattr(servo, each) / _OPTIONS[each][1] for each in options]
    return np.array([np.log(servo.omega), np.log(servo.zeta), *others])


def _servo(values: np.ndarray, options: tuple[str, ...]) -> JointServo:
    others = {each: float(value) * _OPTIONS[each][1] for each, value in zip(options, values[2:])}
    for each in ("delay", "backlash"):
        if each in others:
            others[each] = max(others[each], 0.0)
    return JointServo(float(np.exp(values[0])), float(np.exp(values[1])), **others)


def servo_file(joints: Sequence[IdentifiedJoint], cycle_ns: int, source: str) -> str:
    """Return the text of a file: the servos as they were identified, and by what residual; `source` names the recording."""
    content = {
        "cycle_ms": cycle_ns // 1_000_000,
        "source": source,
        "joints": {
            joint.name: {key: _rounded(getattr(joint.servo, key)) for key in JointServo.__match_args__}
            | {
                "lag_error_ms": _rounded(1e3 * joint.lag_error),
                "residual_rms": _rounded(joint.residual_rms),
                "residual_max": _rounded(joint.residual_max),
            }
            for joint in joints
        },
    }
    head = "# How the arm's servos answer: written by `identify`, read by the launch argument servo_model.\n"
    return head + yaml.safe_dump(content, sort_keys=False)


def _rounded(value: float) -> float:
    return float(f"{value:.9g}")
