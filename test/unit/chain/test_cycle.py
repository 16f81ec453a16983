"""The whole chain with a controller at 12 ms, on a simulated clock: executor, gate, twin and bridge stay at 250 Hz."""

from __future__ import annotations

import numpy as np
import pytest
from chain_samples import REACH, ROBOT, assert_corrections_inside_limits, make_chain, make_plan, play_to_the_end
from simulation import SimulatedChain

from construction_twin.evaluation.alignment import LAG_TOLERANCE_NS, evaluate
from construction_twin.evaluation.tables import error_table
from construction_twin.link.observations import LinkState


def table(chain: SimulatedChain) -> tuple[float, float]:
    """Return the largest error [rad] once the lag is removed, and the lag [ns]."""
    result = evaluate(chain.recording())
    errors = error_table(result.alignments["lag_removed"], ROBOT.joint_names)
    return max(figures["max_rad"] for figures in errors.values()), result.lag_ns


def test_a_task_is_followed_exactly_and_the_lag_is_that_of_two_cycles():
    chain = make_chain(6, cycle=12)
    play_to_the_end(chain, make_plan(chain, REACH, duration=10.0, waypoints=200))
    error, lag = table(chain)
    # AIPos of packet k answers reply k - 3; its command stamp is that of reply k - 1
    assert lag == pytest.approx(24_000_000, abs=LAG_TOLERANCE_NS)
    assert error <= 1.1e-8
    counters, mock = chain.gateway.counters, chain.controller.counters
    assert counters["telegrams"] == pytest.approx(len(chain.twin_poses) / 3, abs=60)
    for name in ("settling", "cycles_without_command", "ipoc_steps_irregular", "commands_lost", "stops_refused"):
        assert counters[name] == 0, name
    assert (mock["missed"], chain.controller.reason) == (0, "")
    assert np.allclose(chain.controller.measured, REACH, atol=1e-8)
    assert_corrections_inside_limits(chain)


@pytest.mark.parametrize("decimals", [3, 6])
def test_full_speed_stays_inside_the_limits_of_12_ms(decimals):
    chain = make_chain(decimals, cycle=12)
    play_to_the_end(chain, make_plan(chain, REACH, speed_scale=0.9, acceleration_scale=0.9))
    assert (chain.gateway.counters["settling"], chain.supervisor.state) == (0, LinkState.ARMED)
    assert_corrections_inside_limits(chain)
