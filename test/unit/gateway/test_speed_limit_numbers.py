"""Speed limits are numbered within their session: a copy or a recording of one does nothing but be counted."""

from __future__ import annotations

import pytest
from gateway_cell import START
from speed_limit_cell import armed, curve, fastest

from construction_twin.mqtt.messages import Control


class TestNumbers:
    def give(self, cell, number, value, session="s1"):
        return cell.take(Control(str(number), session, "speed_limit", value))

    def test_a_recorded_higher_limit_does_not_keep_a_lower_one_from_coming_into_force(self):
        cell = armed(speed_limit_backlog=60.0)
        recorded = [Control(str(1000 + k), "s1", "speed_limit", 1.0) for k in range(5)]
        for control in recorded:
            assert cell.take(control)[0]
        cell.controls = 2000
        for k in range(500):
            # the source says 0.1 at 10 Hz, the recording 1.0 at 12.5 Hz: always one within the grace
            if k % 25 == 0:
                assert cell.control("speed_limit", value=0.1)[0]
            if k % 20 == 10:
                assert cell.take(recorded[k % 5]) == (False, "")
            cell.send(curve(k))
            cell.cycle()
            cell.positions.append(cell.measured)
        assert cell.gateway.status()["speed_limit"] == {"share": 0.1, "given": 0.1, "source": "s1"}
        assert fastest(cell, 200) <= 0.1 + 1e-3
        assert cell.count("refused_repeated") == 25 and cell.count("refused_speed_limit") == 0
        said = "repeated: speed limit 1000 of session 's1', or a later one, came before"
        assert cell.gateway.status()["last_refusal"] == said

    def test_a_recording_does_not_keep_a_source_alive_that_has_died(self):
        cell = armed()
        for _ in range(40):
            self.give(cell, 7, 1.0)
            cell.stream([START] * 10)
        assert cell.count("speed_limit_silent") == 1 and cell.count("refused_repeated") == 39
        assert cell.gateway.status()["speed_limit"] == {"share": 0.1, "given": 0.1, "source": "silence"}

    def test_only_a_higher_number_is_taken_and_what_was_refused_uses_none(self):
        cell = armed()
        answers = [
            self.give(cell, *each)[0] for each in ((0, 0.5), (0, 0.5), (7, 0.4), (6, 1.0), (9, 1.1), (8, 0.3), (8, 0.3))
        ]
        assert answers == [True, False, True, False, False, True, False]
        assert cell.gateway.status()["speed_limit"]["given"] == 0.3

    def test_a_lower_limit_counts_whatever_its_number_a_source_may_have_been_started_again(self):
        cell = armed()
        assert self.give(cell, 1000, 1.0)[0]
        assert self.give(cell, 1, 0.0)[0]
        assert cell.gateway.status()["speed_limit"]["given"] == 0.0
        # and it cannot be lifted by what was sent before
        assert not self.give(cell, 1000, 1.0)[0] and not self.give(cell, 2, 0.5)[0]
        assert cell.gateway.status()["speed_limit"]["given"] == 0.0
        assert self.give(cell, 1001, 0.5)[0]

    @pytest.mark.parametrize("number", ["", "a", "-1", "1.0", " 1", "1e3", "٣", "9" * 20, "cafe"])
    def test_an_id_that_is_no_number_is_refused_with_the_reason(self, number):
        cell = armed()
        ok, reason = self.give(cell, number, 0.5)
        assert not ok and "whole number" in reason and cell.count("refused_speed_limit") == 1
        assert cell.gateway.status()["speed_limit"]["source"] == "none"

    def test_the_next_session_begins_its_own_numbers_and_the_old_ones_stay_void(self):
        cell = armed()
        assert self.give(cell, 500, 0.5)[0]
        cell.control("stop")
        cell.cycle(10)
        cell.controls += 1000
        assert cell.control("reset")[0] and cell.arm("s2")[0]
        # a bridge that was started again counts from the beginning
        assert self.give(cell, 1, 0.4, "s2")[0]
        assert not self.give(cell, 501, 1.0)[0] and not self.give(cell, 1, 1.0, "s2")[0]
        assert cell.gateway.status()["speed_limit"]["given"] == 0.4
