"""Mirror mode: the arm leads, nothing is commanded, and entering or leaving it makes neither robot jump."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chain_samples import REACH, ROBOT, make_chain, make_plan, play_to_the_end
from hypothesis import given, settings
from hypothesis import strategies as st
from supervisor_bench import Bench, armed, bench, moved

from construction_twin.core.errors import ReviewError
from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE, CYCLE_NS, format_allowance, radians
from construction_twin.execution.executor import ExecutorState
from construction_twin.gateway.gateway import State
from construction_twin.link.observations import LinkState
from construction_twin.monitor.states import SyncState
from construction_twin.twin.virtual_robot import DECIMALS, MirrorTwin, VirtualRobot

#: Fixtures of the bench.
__all__ = ["armed", "bench"]
LIMITS = MotionLimits(("a", "b"), (-2.0, -2.0), (2.0, 2.0), (2.0, 4.0), (2.3, 17.0))
JOGGED = radians((20.0, -80.0, 80.0, 10.0, 80.0, -20.0))


class TestSupervisor:
    def test_enters_with_a_session_of_its_own_and_ends_the_one_before(self, armed):
        before = armed.supervisor.session
        assert "arm leads" in armed.supervisor.begin_mirror(armed.now)
        armed.run(1.0)
        assert armed.state is LinkState.MIRROR and not armed.forwarded
        assert armed.supervisor.session != before
        assert [(control.verb, control.session) for control in armed.sent] == [("reset", before)]
        assert armed.gateway["state"] == "ready" and not armed.gateway.get("fault")

    def test_a_lost_end_of_the_session_is_asked_for_again(self, armed):
        carry_out, armed.carry_out = armed.carry_out, lambda control: None
        armed.supervisor.begin_mirror(armed.now)
        armed.run(1.2)
        assert armed.verbs == ["reset"] * 3
        armed.carry_out = carry_out
        armed.run(1.0)
        assert len(armed.sent) == 4 and armed.gateway["state"] == "ready"

    def test_is_refused_while_the_arm_moves(self, armed):
        armed.pose = moved(0.1)
        armed.poll()
        with pytest.raises(ReviewError, match="still changing"):
            armed.supervisor.begin_mirror(armed.now)
        assert not armed.supervisor.mirrors

    def test_is_refused_without_an_arm(self, bench):
        bench.set_gateway("no_controller", "no telegram yet")
        bench.run(0.5)
        with pytest.raises(ReviewError, match="no telegram yet"):
            bench.supervisor.begin_mirror(bench.now)

    def test_leaving_starts_over_like_a_reset_and_arms(self, armed):
        armed.supervisor.begin_mirror(armed.now)
        armed.run(1.0)
        mirrored = armed.supervisor.session
        armed.supervisor.end_mirror(armed.now)
        armed.run(1.0)
        assert armed.state is LinkState.ARMED and armed.supervisor.session != mirrored
        assert armed.gateway["session"] == armed.supervisor.session

    def test_is_not_left_while_the_arm_moves(self, armed):
        armed.supervisor.begin_mirror(armed.now)
        armed.pose = moved(0.2)
        armed.poll()
        with pytest.raises(ReviewError, match="still changing"):
            armed.supervisor.end_mirror(armed.now)
        assert armed.state is LinkState.MIRROR

    def test_works_read_only(self, bench):
        bench.set_gateway("read_only", "ONLYSEND")
        bench.run(0.5)
        assert bench.state is LinkState.NO_CONTROLLER
        bench.supervisor.begin_mirror(bench.now)
        bench.run(0.5)
        assert bench.state is LinkState.MIRROR and bench.sent == []
        bench.supervisor.end_mirror(bench.now)
        bench.run(0.5)
        assert bench.state is LinkState.NO_CONTROLLER and bench.sent == []

    @pytest.mark.parametrize("request_name", ["request_reset", "request_arm"])
    def test_nothing_else_starts_a_session_meanwhile(self, armed, request_name):
        armed.supervisor.begin_mirror(armed.now)
        armed.run(0.5)
        with pytest.raises(ReviewError):
            getattr(armed.supervisor, request_name)(armed.now)

    def test_a_bridge_that_is_started_again_waits_for_a_person(self, armed):
        armed.supervisor.begin_mirror(armed.now)
        armed.run(0.5)
        bench = Bench(armed.supervisor.waits_for)
        bench.run(1.0)
        assert bench.state is LinkState.NEEDS_RESET and bench.sent == [] and not bench.forwarded
        assert "the arm led" in bench.supervisor.reason
        bench.supervisor.begin_mirror(bench.now)
        bench.run(0.5)
        assert bench.state is LinkState.MIRROR
        bench.supervisor.end_mirror(bench.now)
        bench.run(1.0)
        assert bench.state is LinkState.ARMED


class TestTwin:
    @settings(max_examples=40, deadline=None)
    @given(
        first=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)),
        poses=st.lists(
            st.tuples(st.floats(-2.5, 2.5), st.floats(-2.5, 2.5), st.integers(1, 3)), min_size=1, max_size=60
        ),
    )
    def test_whatever_is_measured_it_never_jumps_and_arrives(self, first, poses):
        twin, stamp, positions = MirrorTwin(LIMITS, first), 0, [first]
        targets = [(a, b) for a, b, cycles in poses for _ in range(cycles * 10)]
        targets += [tuple(max(-2.0, min(2.0, v)) for v in targets[-1])] * 1500
        for q in targets:
            stamp += CYCLE_NS
            positions.append(twin.follow(stamp, q))
        moves = np.diff([first, *positions], axis=0)
        digit, allowance = math.radians(10.0**-DECIMALS), format_allowance(DECIMALS)
        assert (np.abs(moves) <= np.array(LIMITS.velocity) * CYCLE + digit + 1e-12).all()
        assert (
            np.abs(np.diff(moves, axis=0)) <= (np.array(LIMITS.acceleration) + allowance) * CYCLE**2 * (1 + 1e-8)
        ).all()
        assert positions[-1] == pytest.approx(targets[-1], abs=1e-12) and twin.arrived

    def test_after_lost_states_it_may_move_for_the_time_that_went_by(self):
        twin = MirrorTwin(LIMITS, (0.0, 0.0))
        for k in [*range(1, 100), *range(102, 400, 3)]:
            q = (0.3 * (1 - math.cos(k * CYCLE)), 0.0)
            assert twin.follow(k * CYCLE_NS, q)[0] == pytest.approx(q[0], abs=1e-4)

    def test_the_robot_refuses_commands_while_it_mirrors(self):
        robot = VirtualRobot((0.0, 0.0))
        robot.begin_mirror(LIMITS)
        assert robot.mirrors and not robot.execute(CYCLE_NS, (0.0, 0.0))
        assert robot.follow(CYCLE_NS, (1e-5, 0.0)) and robot.pose == (1e-5, 0.0)
        robot.end_mirror()
        assert not robot.follow(2 * CYCLE_NS, (1.0, 0.0)) and robot.execute(3 * CYCLE_NS, robot.pose)

    def test_an_older_measurement_moves_nothing(self):
        twin = MirrorTwin(LIMITS, (0.0, 0.0))
        twin.follow(8, (0.0, 0.0))
        assert twin.follow(8, (0.1, 0.0)) is None


def assert_no_jump(poses, since: int = 0) -> None:
    """Every step of a robot is inside its velocity limits."""
    moves = np.abs(np.diff(np.array([pose for _, pose in poses[since:]]), axis=0))
    assert (moves <= np.array(ROBOT.velocity) * CYCLE + math.radians(1e-3)).all()


class TestWholeChain:
    def test_the_twin_follows_the_arm_s_own_program_and_a_plan_runs_afterwards(self):
        chain = make_chain(3)
        play_to_the_end(
            chain, make_plan(chain, radians((5.0, -85.0, 85.0, 5.0, 85.0, 5.0)), duration=2.0, waypoints=50)
        )
        chain.supervisor.begin_mirror(chain.now)
        chain.run_for(0.5)
        assert chain.supervisor.state is LinkState.MIRROR and chain.twin.mirrors
        assert chain.gateway.state is State.READY and not chain.gateway.fault
        assert chain.gate.state is SyncState.WAITING
        sent, mirrored_since = chain.commands_sent, len(chain.twin_poses)
        corrections = len(chain.corrections)
        chain.controller.run_program(JOGGED)
        chain.run_for(10.0)
        assert chain.commands_sent == sent and chain.gate.state is SyncState.WAITING
        assert np.abs(np.array(chain.controller.measured) - JOGGED).max() < 1e-6
        assert np.abs(np.array(chain.twin.pose) - chain.controller.measured).max() < math.radians(1e-3)
        # commands nothing: the correction is what it was
        assert np.ptp(np.array([c for _, c in chain.corrections[corrections:]]), axis=0).max() < 1e-12
        assert_no_jump(chain.twin_poses, mirrored_since)
        chain.supervisor.end_mirror(chain.now)
        assert chain.run_until(lambda: chain.ready, 5.0), chain.supervisor.reason
        assert_no_jump(chain.twin_poses)
        assert_no_jump(chain.measured)
        play_to_the_end(chain, make_plan(chain, REACH, duration=4.0, waypoints=100))
        assert np.abs(np.array(chain.controller.measured) - REACH).max() < math.radians(1e-3)
        assert_no_jump(chain.twin_poses)
        assert_no_jump(chain.measured)
        assert not [name for name in chain.gateway.counters if name.startswith(("stops_", "refused_start"))]

    def test_it_is_refused_while_a_plan_is_played(self):
        chain = make_chain(3)
        chain.play(make_plan(chain, REACH, duration=4.0, waypoints=100))
        chain.run_for(1.5)
        assert chain.executor.state is ExecutorState.PLAYING
        with pytest.raises(ReviewError):
            chain.supervisor.begin_mirror(chain.now)
        assert chain.run_until(lambda: chain.executor.outcome == "finished", 10.0)
