"""Which states count: old ones, lost ones, restarts, and single messages from somebody else."""

from __future__ import annotations

import pytest

from construction_twin.core.errors import PayloadError
from construction_twin.core.travel_time import TravelTime
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.link.bridge import CONFIRMATIONS, MAX_JUMP, StateCheck

LIMIT = 0.1
LIMIT_NS = round(LIMIT * NANOSECONDS)
#: The gateway's clock began at another time than ours.
OFFSET = 77 * NANOSECONDS


def reason(call, *args) -> str:
    """Return what it was refused for, or ""."""
    try:
        call(*args)
    except PayloadError as error:
        return error.reason
    return ""


def reasons(check: StateCheck, numbers) -> list[str]:
    return [reason(check.accept, seq, 0, OFFSET) for seq in numbers]


class Numbered:
    """A check of states whose numbers are in order."""

    def __init__(self):
        self.check, self.seq = StateCheck(LIMIT), 0

    def accept(self, stamp: int, received: int) -> None:
        """Take the next state."""
        self.seq += 1
        self.check.accept(self.seq, stamp, received)


class TestTravelTime:
    def test_the_excess_is_told_from_the_quickest_one(self):
        travel = TravelTime()
        assert travel.record(1000, 7000) == 0 and travel.record(1000, 7500) == 500
        assert travel.record(3000, 8000) == 0 and travel.record(3000, 8001) == 1

    def test_the_measured_excess_changes_nothing_and_is_negative_for_a_quicker_one(self):
        travel = TravelTime()
        assert travel.excess(1000, 7000) == 0
        travel.record(1000, 7000)
        assert [travel.excess(1500, 7000), travel.excess(1500, 7000), travel.excess(0, 7000)] == [-500, -500, 1000]
        assert travel.record(1000, 7500) == 500


class TestSequence:
    def check(self, last: int = 1000) -> StateCheck:
        check = StateCheck(LIMIT)
        assert reasons(check, range(1, last + 1)) == [""] * last
        return check

    def test_counts_what_is_missing(self):
        check = self.check()
        assert reasons(check, (1001, 1003, 1003 + MAX_JUMP)) == [""] * 3
        assert check.lost == 1 + MAX_JUMP - 1

    @pytest.mark.parametrize("seq", [1, 2, 999, 1000, 1002 + MAX_JUMP, 10**18])
    def test_one_number_from_nowhere_is_refused_and_changes_nothing(self, seq):
        check = self.check()
        assert reasons(check, (seq, 1001, seq, 1002)) == ["sequence", "", "sequence", ""]
        assert check.lost == 0

    def test_numbers_in_a_row_between_those_of_the_gateway_are_not_believed(self):
        check = self.check()
        strangers = range(10**9, 10**9 + 20)
        assert reasons(check, strangers[:CONFIRMATIONS]) == ["sequence"] * CONFIRMATIONS
        for k, seq in enumerate(strangers[CONFIRMATIONS:]):
            assert reasons(check, (1001 + k, seq)) == ["", "sequence"]

    def test_the_same_number_again_confirms_nothing(self):
        assert set(reasons(self.check(), [10**9] * 20)) == {"sequence"}

    @pytest.mark.parametrize("begin", [1, 500, 100_000])
    def test_a_sender_that_goes_on_elsewhere_is_believed_after_a_few(self, begin):
        expected = ["sequence"] * CONFIRMATIONS + [""] * 5
        assert reasons(self.check(), range(begin, begin + CONFIRMATIONS + 5)) == expected

    def test_tells_a_restart_from_a_gap(self):
        for begin, restarted in ((1, True), (5000, False)):
            check = self.check()
            reasons(check, range(begin, begin + CONFIRMATIONS))
            assert reasons(check, (begin + CONFIRMATIONS,)) == [""]
            assert check.lost == (0 if restarted else 3999)

    def test_after_a_known_restart_it_takes_what_comes(self):
        check = self.check()
        check.restart()
        assert reasons(check, (1, 2)) == ["", ""] and check.lost == 0

    def test_a_wrong_first_number_is_outvoted(self):
        check = StateCheck(LIMIT)
        check.accept(10**18, 0, OFFSET)
        assert reasons(check, range(7, 12)) == ["sequence"] * CONFIRMATIONS + ["", ""]


class TestFreshness:
    def check(self, travel: int = 1_000_000) -> Numbered:
        check = Numbered()
        check.accept(0, OFFSET + travel)
        return check

    @pytest.mark.parametrize("extra, refused", [(0, ""), (LIMIT_NS, ""), (LIMIT_NS + 100_000, "stale")])
    def test_refuses_what_travelled_longer_than_allowed(self, extra, refused):
        assert reason(self.check().accept, CYCLE_NS, CYCLE_NS + OFFSET + 1_000_000 + extra) == refused

    def test_a_backlog_delivered_in_one_burst_is_old(self):
        received = OFFSET + NANOSECONDS
        found = [reason(self.check().accept, stamp, received) for stamp in range(0, NANOSECONDS, CYCLE_NS)]
        assert found.index("") == pytest.approx((NANOSECONDS - LIMIT_NS) / CYCLE_NS, abs=1)
        assert set(found[: found.index("")]) == {"stale"} and set(found[found.index("") :]) == {""}

    def test_what_is_refused_does_not_become_the_measure(self):
        check = self.check()
        late = OFFSET + 1_000_000 + 2 * LIMIT_NS
        assert {reason(check.accept, k * CYCLE_NS, k * CYCLE_NS + late) for k in range(1, 1000)} == {"stale"}

    @pytest.mark.parametrize("drift", [-90e-6, 90e-6])
    def test_clocks_that_drift_apart_make_nothing_old(self, drift):
        check = self.check()
        for stamp in range(0, 3 * 3600 * NANOSECONDS, 10 * NANOSECONDS):
            check.accept(stamp, OFFSET + 1_000_000 + stamp + round(stamp * drift))

    def test_one_stamp_from_the_future_is_refused_and_changes_nothing(self):
        check = self.check()
        assert reason(check.accept, 10**18, OFFSET + CYCLE_NS) == "early"
        assert reason(check.accept, CYCLE_NS, OFFSET + CYCLE_NS + 1_000_000) == ""
        assert check.check.lost == 0

    @pytest.mark.parametrize("lost_between", [0, 1])
    def test_a_beginning_with_old_states_is_overcome_and_none_of_those_refused_counts_as_lost(self, lost_between):
        check, found = self.check(5 * LIMIT_NS), []
        for _ in range(9):
            check.seq += lost_between
            found.append(reason(check.accept, check.seq * CYCLE_NS, OFFSET + check.seq * CYCLE_NS))
        assert found == ["early"] * CONFIRMATIONS + [""] * (9 - CONFIRMATIONS)
        assert check.check.lost == 9 * lost_between


class TestBoth:
    def check(self) -> StateCheck:
        check = StateCheck(LIMIT)
        for seq in range(1, 1000):
            check.accept(seq, seq * CYCLE_NS, OFFSET + seq * CYCLE_NS)
        return check

    def test_after_a_gap_old_states_are_still_old(self):
        check, received = self.check(), OFFSET + 3000 * CYCLE_NS
        found = [reason(check.accept, seq, seq * CYCLE_NS, received) for seq in range(2000, 2010)]
        assert found == ["sequence"] * CONFIRMATIONS + ["stale"] * (10 - CONFIRMATIONS)

    @pytest.mark.parametrize("announced", [False, True])
    def test_a_restarted_gateway_has_another_clock(self, announced):
        check = self.check()
        if announced:
            check.restart()
        received = OFFSET + 2000 * CYCLE_NS
        found = [reason(check.accept, seq, seq * CYCLE_NS, received + seq * CYCLE_NS) for seq in range(1, 11)]
        refused = 0 if announced else CONFIRMATIONS
        assert found == ["sequence"] * refused + [""] * (10 - refused)
