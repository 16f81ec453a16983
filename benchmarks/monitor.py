"""Monitor benchmark: what the gate finds with a model of the arm's servos, how soon, and what it takes for a fault that is none.

    python benchmarks/monitor.py --output results/bench/monitor.json

All on the simulated clock, with poses of 3 decimals of a degree; the figures do not depend on the machine. The model is
identified from 30 s of motion. `stall_samples`: poses until the gate closes when a joint stalls at full speed, by joint.
`slip_deg`: the smallest of some slips that closes it for each joint, sign and speed. `expected_avg_rad`: mean residual per joint
over a task (Table 1 of the paper). `false_holds`: of a long run (`--hour`) with the realistic servo and payloads that make it up to
3 % softer, changed at rest. `other_arm`: an arm with mass whose servos know nothing of its friction and of a payload that comes
and goes: largest and mean residual per joint, and the smallest threshold that would have held nothing. `without_model`: the same
stalls and slips at a gate without a model.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "test/support"))

from chain_samples import ROBOT, make_plan, play_to_the_end  # noqa: E402
from link_world import write_figures  # noqa: E402
from servo_chain import (  # noqa: E402
    NAMES,
    ForeignPlant,
    LadenServo,
    Work,
    fault_in_motion,
    identified,
    model_of,
    poses,
    servo_chain,
    servo_of,
    slip,
)

from construction_twin.core.units import NANOSECONDS  # noqa: E402
from construction_twin.evaluation.alignment import evaluate  # noqa: E402
from construction_twin.mock.faults import Fault  # noqa: E402
from construction_twin.mock.servo import Servo  # noqa: E402
from construction_twin.servo.model import ServoModel  # noqa: E402

#: Slips that are tried, the smallest first [deg], and at which part of a sweep.
SLIPS, SHARES = (0.58, 0.6, 0.65, 0.7, 0.75), (0.2, 0.5, 1.0)
#: Motions for the identification and for the task of Table 1.
IDENTIFIED, TASK = 12, 20
#: Payload, friction as a fraction of the torque, and length of the run of the other arm [s].
OTHER_MASS, OTHER_FRICTION, OTHER_TIME = 120.0, 0.05, 300.0


def identify_arm(arm: Servo | None = None) -> tuple[ServoModel, dict]:
    """Return the model of an arm as a recording of some motion gives it, and how well it explains that."""
    chain = servo_chain(None, arm=arm)
    for goal in itertools.islice(poses(1), IDENTIFIED):
        play_to_the_end(chain, make_plan(chain, goal))
    found = identified(chain)
    return model_of(found), {joint.name: rounded(joint.residual_rms) for joint in found}


def stalls(model: ServoModel | None) -> dict[str, int | None]:
    """Return by which pose with a stall the gate closed, by joint; None: not within 0.4 s."""
    return {
        name: fault_in_motion(model, joint, Fault("stall", ROBOT.axes[joint].name))[0]
        for joint, name in enumerate(NAMES)
    }


def smallest_slip(model: ServoModel | None) -> float | None:
    """Return the smallest slip that closes the gate in motion whatever joint, sign and speed [deg]; None: none of those tried."""
    for angle in SLIPS:
        tried = itertools.product(range(len(NAMES)), SHARES, (angle, -angle))
        if all(fault_in_motion(model, joint, slip(joint, each), share)[0] for joint, share, each in tried):
            return angle
    return None


def table_1(model: ServoModel) -> dict[str, float]:
    """Return the mean residual per joint over a task with the realistic servo [rad]."""
    chain = servo_chain(model)
    totals, count = np.zeros(len(NAMES)), 0
    for goal in itertools.islice(poses(2), TASK):
        play_to_the_end(chain, make_plan(chain, goal))
        aligned = evaluate(chain.recording()).alignments["expected"]
        totals += aligned.average * len(aligned.stamps)
        count += len(aligned.stamps)
    return by_joint(totals / count)


def hour(model: ServoModel, duration: float) -> dict:
    """Return what came of a long run with the realistic servo and changing payloads."""
    servo = LadenServo()
    chain = servo_chain(model, arm=servo)
    work, softer = Work(chain, 3), itertools.cycle((0.0, 0.03, 0.01, 0.02))
    begin, started = chain.now, time.monotonic()
    work.run(duration, lambda number: servo.carry(next(softer)) if number % 20 == 0 else None)
    watch = chain.gate.servo_watch
    return {
        "simulated_s": (chain.now - begin) // NANOSECONDS,
        "took_s": rounded(time.monotonic() - started),
        "holds": work.holds,
        "judged": watch.judged,
        "largest_rad": by_joint(work.largest),
        "refined": sum(change.event.value == "servos_refined" for change in work.changes),
    }


def other_arm(duration: float) -> dict:
    """Return what came of an arm with mass that is not of the model's class."""
    model, residuals = identify_arm(servo_of(ForeignPlant(OTHER_MASS / 2, OTHER_FRICTION)))
    plant = ForeignPlant(OTHER_MASS, OTHER_FRICTION)
    chain = servo_chain(model, arm=servo_of(plant))
    work = Work(chain, 4)
    work.run(duration, lambda number: setattr(plant, "laden", number % 2 == 0))
    return {
        "payload_kg": OTHER_MASS,
        "friction": OTHER_FRICTION,
        "identified_rms_rad": residuals,
        "largest_rad": by_joint(work.largest),
        "avg_rad": by_joint(work.average),
        "threshold_rad": rounded(float(work.largest.max())),
        "holds": work.holds,
        "judged": chain.gate.servo_watch.judged,
    }


def by_joint(values) -> dict[str, float]:
    """Return values by joint name, to three digits."""
    return {name: rounded(float(value)) for name, value in zip(NAMES, values)}


def rounded(value: float) -> float:
    """Return a figure to three significant digits."""
    return float(f"{value:.3g}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description="Monitor benchmark: what the gate finds with a model of the arm's servos."
    )
    parser.add_argument("--output", type=Path, default=ROOT / "results/bench/monitor.json", help="file of the figures")
    parser.add_argument("--hour", type=float, default=900.0, help="length of the long run [s] (default: 900)")
    options = parser.parse_args()
    model, residuals = identify_arm()
    long = hour(model, options.hour)
    figures = {
        "stall_samples": stalls(model),
        "slip_deg": smallest_slip(model),
        "false_holds": len(long["holds"]),
        "expected_avg_rad": table_1(model),
        "hour": long,
        "identified_rms_rad": residuals,
        "other_arm": other_arm(min(OTHER_TIME, options.hour)),
        "without_model": {"stall_samples": stalls(None), "slip_deg": smallest_slip(None)},
    }
    write_figures(options.output, figures)


if __name__ == "__main__":
    main()
