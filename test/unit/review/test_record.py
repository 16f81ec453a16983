"""The review record: what it holds, that it is on the disk before anything moves, and that tampering is found."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
from dataclasses import replace
from pathlib import Path

import pytest
from memory import size
from plan_samples import make_plan
from sentence_checks import expects, holds, says

from construction_twin.core.errors import ConfigurationError, RecordError
from construction_twin.core.reports import SessionRequest, SpeedChange
from construction_twin.review import record as review_log
from construction_twin.review.chained_file import BEGIN, verify
from construction_twin.review.plan_under_review import APPROVED, REFUSED, Ending, Verdict
from construction_twin.review.record import KEPT, Responsibility, ReviewLog, main
from construction_twin.robot.plan import Clearance
from construction_twin.robot.trajectory import Trajectory

NOW = 1_790_000_000_123_456_789
MOTION = Trajectory(("a",), [0.0, 1.5], [[0.0], [1.0]], [[0.0]] * 2, [[0.0]] * 2)
PLAN = make_plan(MOTION, "p", "5ce0e")


def verdict(plan_id: str = "p", **changes) -> Verdict:
    return replace(Verdict(APPROVED, plan_id, PLAN.hash, "Ada", "looks good", PLAN), **changes)


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "deep" / "reviews.jsonl"


@pytest.fixture
def log(path):
    log = ReviewLog(path, lambda: NOW)
    yield log
    log.close()


@pytest.fixture
def written(path) -> Path:
    """A file of five records whose writer has ended."""
    log = ReviewLog(path, lambda: NOW)
    for number in range(4):
        log.append(verdict(f"p{number}"))
    log.append(Ending(replace(PLAN, id="p3"), "finished", "as Ada said"))
    log.close()
    return path


def lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


class TestContent:
    def test_a_verdict_tells_who_when_why_and_on_what(self, log, path):
        report = replace(PLAN.report, clearance=Clearance(0.0312, ("link_5", "wall"), (1.0, 0.0, 0.5), 0.75))
        log.append(verdict(plan=replace(PLAN, report=report)))
        assert lines(path) == [
            {
                "time": "2026-09-21T14:13:20.123456789Z",
                "time_ns": NOW,
                "record": "verdict",
                "verdict": "approved",
                "plan": "p",
                "trajectory": MOTION.content_hash(),
                "reviewer": "Ada",
                "reason": "looks good",
                "scene": "5ce0e",
                "source": "test",
                "planner": "none",
                "duration": 1.5,
                "clearance": 0.0312,
                "clearance_between": ["link_5", "wall"],
                "clearance_time": 0.75,
                "previous": BEGIN,
            }
        ]

    def test_a_clearance_without_anything_to_touch_is_null(self, log, path):
        assert math.isinf(PLAN.report.clearance.distance)
        log.append(verdict())
        assert lines(path)[0]["clearance"] is None

    def test_a_refusal_of_an_unknown_plan_has_no_details(self, log, path):
        log.append(Verdict(REFUSED, "x", "", "Ada", "plan x is not under review"))
        assert "scene" not in lines(path)[0] and lines(path)[0]["verdict"] == "refused"

    def test_what_became_of_an_execution_is_a_record_of_its_own(self, log, path):
        log.append(Ending(PLAN, "stopped", "stop requested"))
        (record,) = lines(path)
        assert (record["record"], record["plan"], record["trajectory"]) == ("execution", "p", PLAN.hash)
        assert (record["outcome"], record["reason"]) == ("stopped", "stop requested")

    def test_words_cannot_break_out_of_their_line(self, log, path):
        reason = 'line\nbreak "quoted" \u2028 Schöne Grüße'
        log.append(verdict(reason=reason))
        log.append(verdict())
        assert lines(path)[0]["reason"] == reason and verify(path).lines == 2

    def test_each_line_holds_the_hash_of_the_one_before(self, written):
        raw = written.read_bytes().splitlines()
        hashes = [BEGIN] + [hashlib.sha256(line).hexdigest() for line in raw]
        assert [record["previous"] for record in lines(written)] == hashes[:-1]
        assert verify(written) == review_log.LogState(5, hashes[-1])

    def test_who_is_responsible_for_a_bare_plc_is_recorded_and_stands_in_every_verdict(self, log, path):
        bare = Responsibility("Grace", "s1", ("configuration: not compared", "age: not known"))
        log.append(verdict("before"))
        log.responsibility = bare
        log.defer(bare)
        log.defer(verdict("deferred"))
        log.responsibility = None
        log.append(verdict("after"))
        before, armed, deferred, after = lines(path)
        assert (armed["record"], armed["responsible"], armed["session"]) == ("responsibility", "Grace", "s1")
        for line in (armed, deferred):
            assert line["responsible"] == "Grace" and line["not_checked"] == list(bare.not_checked)
        assert not {"responsible", "not_checked"} & {*before, *after} and verify(path).lines == 4

    def test_who_has_asked_for_a_session_or_set_the_speed_limit_is_recorded(self, log, path):
        log.defer(SessionRequest("reset", "ada", "stop 3", 7))
        log.defer(SpeedChange("dora", 0.5, 0.3, "bob", 8))
        log.flush()
        told = ("record", "verb", "person", "lifts", "limit", "before", "whose")
        session, speed = ({key: line[key] for key in told if key in line} for line in lines(path))
        assert session == {"record": "session", "verb": "reset", "person": "ada", "lifts": "stop 3"}
        assert speed == {"record": "speed", "person": "dora", "limit": 0.5, "before": 0.3, "whose": "bob"}


class TestContinuation:
    def test_an_existing_file_is_continued(self, written):
        log = ReviewLog(written, lambda: NOW)
        log.append(verdict("later"))
        log.close()
        assert verify(written).lines == 6 and lines(written)[-1]["plan"] == "later"

    @pytest.mark.parametrize("call", ["write", "fsync"])
    def test_a_writer_that_ended_half_way_through_a_record_is_no_tampering(self, written, monkeypatch, call):
        """The writer ends just before each of these calls."""
        log = ReviewLog(written, lambda: NOW)

        def end_here(*_):
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(os, call, end_here)
            with pytest.raises(KeyboardInterrupt):
                log.append(verdict("interrupted"))
        log.close()
        log = ReviewLog(written, lambda: NOW)
        log.append(verdict("later"))
        log.close()
        verify(written)
        assert lines(written)[-1]["plan"] == "later"

    def test_an_execution_that_the_executor_did_not_survive_gets_its_end_recorded(self, path):
        log = ReviewLog(path, lambda: NOW)
        log.append(verdict("p0"))
        log.append(Ending(PLAN, "finished", "goal reached"))
        log.append(verdict("p1"))
        # what people did meanwhile is of no plan
        log.defer(SpeedChange("dora", 0.3, 1.0, ""))
        log.defer(SessionRequest("reset", "ada", "stop 3"))
        log.flush()
        log.close()
        ReviewLog(path, lambda: NOW + 1).close()
        record = lines(path)[-1]
        assert (record["record"], record["plan"], record["outcome"]) == ("execution", "p1", "dropped")
        assert record["time_ns"] == NOW + 1 and "the executor ended" in record["reason"]
        ReviewLog(path, lambda: NOW).close()
        assert verify(path).lines == 6

    def test_an_execution_that_has_its_end_gets_no_other(self, path):
        log = ReviewLog(path, lambda: NOW)
        log.append(verdict())
        log.append(verdict(verdict=REFUSED, reason="decided already"))
        log.append(Ending(PLAN, "finished", "goal reached"))
        log.close()
        ReviewLog(path, lambda: NOW).close()
        assert verify(path).lines == 3

    def test_a_broken_file_is_not_continued(self, written):
        written.write_bytes(written.read_bytes().replace(b'"p2"', b'"p9"'))
        with pytest.raises(ConfigurationError, match="line 4"):
            ReviewLog(written, lambda: NOW)

    def test_two_writers_of_one_file_are_refused(self, log, path):
        with pytest.raises(ConfigurationError, check=expects("expected.record.own", writer="executor")):
            ReviewLog(path, lambda: NOW)

    @pytest.mark.parametrize("empty", ["", "  "])
    def test_no_file_is_refused(self, empty):
        with pytest.raises(ConfigurationError, check=expects("expected.record.path")):
            ReviewLog(empty, lambda: NOW)

    def test_a_folder_that_cannot_be_made_is_refused(self, tmp_path):
        (tmp_path / "file").write_text("")
        with pytest.raises(ConfigurationError, check=expects("expected.writable")):
            ReviewLog(tmp_path / "file" / "reviews.jsonl", lambda: NOW)

    def test_the_home_folder_can_be_written_as_a_tilde(self, tmp_path, monkeypatch):
        monkeypatch.setenv("HOME", str(tmp_path))
        log = ReviewLog("~/reviews.jsonl", lambda: NOW)
        log.append(verdict())
        log.close()
        assert verify(tmp_path / "reviews.jsonl").lines == 1


def edit(number: int, old: str, new: str):
    def change(rows: list[str]) -> list[str]:
        assert old in rows[number]
        rows[number] = rows[number].replace(old, new)
        return rows

    return change


def forge(rows: list[str]) -> str:
    """Return a line that continues the chain."""
    return json.dumps({"verdict": "approved", "previous": hashlib.sha256(rows[-1].encode()).hexdigest()})


TAMPERING = {
    "an edited line": (edit(1, "Ada", "Bob"), "line 3"),
    "an edited first line": (edit(0, "Ada", "Bob"), "line 2"),
    "another time": (edit(2, "14:13:20", "14:13:21"), "line 4"),
    "another verdict": (edit(3, "approved", "rejected"), "line 5"),
    "another previous": (edit(2, '"previous": "', '"previous": "0'), "line 3"),
    "a removed line": (lambda rows: rows[:2] + rows[3:], "line 3"),
    "the first line removed": (lambda rows: rows[1:], "line 1"),
    "two lines in another order": (lambda rows: [rows[0], rows[2], rows[1], *rows[3:]], "line 2"),
    "a repeated line": (lambda rows: [*rows, rows[-1]], "line 6"),
    "an inserted line": (lambda rows: [*rows[:2], '{"verdict": "approved"}', *rows[2:]], "line 3"),
    "something else than JSON": (lambda rows: [rows[0], "hello", *rows[2:]], "line 2"),
    "something else than an object": (lambda rows: [rows[0], "[1]", *rows[2:]], "line 2"),
    "an empty line": (lambda rows: [*rows[:3], "", *rows[3:]], "line 4"),
}


class TestTampering:
    @pytest.mark.parametrize("change, where", TAMPERING.values(), ids=TAMPERING.keys())
    def test_is_found_and_the_line_named(self, written, change, where):
        rows = change(written.read_text().splitlines())
        written.write_text("".join(row + "\n" for row in rows))
        with pytest.raises(ConfigurationError) as error:
            verify(written)
        assert error.value.where == f"{written} {where}"

    def test_every_truncation_within_a_line_is_found(self, written):
        content = written.read_bytes()
        for length in range(0, len(content), 7):
            if content[:length].endswith(b"\n") or length == 0:
                continue
            written.write_bytes(content[:length])
            with pytest.raises(ConfigurationError):
                verify(written)

    def test_every_flipped_bit_before_the_last_line_is_found(self, written):
        content = bytearray(written.read_bytes())
        for place in range(0, content[:-1].rindex(b"\n"), 11):
            content[place] ^= 1
            written.write_bytes(bytes(content))
            with pytest.raises(ConfigurationError):
                verify(written)
            content[place] ^= 1

    @pytest.mark.parametrize(
        "change",
        [lambda rows: rows[:-1], lambda rows: [], edit(4, "Ada", "Bob"), lambda rows: [*rows, forge(rows)]],
        ids=["cut", "emptied", "edited", "added"],
    )
    def test_the_last_hash_shows_what_was_done_to_the_end(self, written, change):
        noted = verify(written)
        written.write_text("".join(row + "\n" for row in change(written.read_text().splitlines())))
        assert verify(written).head != noted.head

    def test_a_missing_file_is_named(self, tmp_path):
        with pytest.raises(ConfigurationError, match="nowhere"):
            verify(tmp_path / "nowhere")


class TestWriting:
    def test_a_record_is_synced_before_append_returns(self, log, path, monkeypatch):
        synced = []
        sync = os.fsync
        monkeypatch.setattr(os, "fsync", lambda file: (sync(file), synced.append(os.fstat(file).st_ino)))
        log.append(verdict())
        assert path.stat().st_ino in synced

    @pytest.mark.parametrize("call", ["write", "fsync"])
    def test_what_could_not_be_written_is_taken_back_and_can_be_written_later(self, log, path, monkeypatch, call):
        log.append(verdict())

        def fail(*_):
            raise OSError(errno.ENOSPC, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr(os, call, fail)
            with pytest.raises(
                RecordError, check=says("review.no_record", problem="[Errno 28] No space left on device")
            ) as error:
                log.append(verdict("lost"))
            assert error.value.path == str(path)
        assert verify(path).lines == 1
        log.append(verdict("kept"))
        assert [record["plan"] for record in lines(path)] == ["p", "kept"] and verify(path).lines == 2

    def test_half_a_line_is_taken_back(self, log, path, monkeypatch):
        write = os.write
        with monkeypatch.context() as patch:
            patch.setattr(os, "write", lambda file, data: write(file, data[: len(data) // 2]))
            with pytest.raises(RecordError, check=holds("problem", "reason.file.cut")):
                log.append(verdict())
        assert path.read_bytes() == b""

    @pytest.mark.parametrize(
        "change, problem",
        [
            (lambda path: path.unlink(), "gone"),
            (lambda path: path.rename(path.with_name("moved")), "gone"),
            (lambda path: (path.unlink(), path.write_text("")), "replaced"),
            (lambda path: os.truncate(path, 10), "other_writer"),
            (lambda path: path.open("a").write("{}\n"), "other_writer"),
        ],
        ids=["removed", "moved", "replaced", "cut", "written to"],
    )
    def test_a_file_that_somebody_touched_takes_no_more_records(self, log, path, change, problem):
        log.append(verdict())
        change(path)
        with pytest.raises(RecordError, check=holds("problem", f"reason.file.{problem}")):
            log.append(verdict())

    def test_deferred_records_come_first_with_the_time_they_were_deferred_at(self, path):
        times = iter((1, 2, 3))
        log = ReviewLog(path, lambda: next(times))
        log.defer(Ending(PLAN, "finished", "goal reached"))
        assert path.read_bytes() == b""
        log.append(verdict("next"))
        log.defer(Ending(PLAN, "held", "the gate holds"))
        log.flush()
        log.close()
        assert [(record["time_ns"], record["plan"]) for record in lines(path)] == [(1, "p"), (2, "next"), (3, "p")]

    def test_what_cannot_be_flushed_is_kept(self, log, path, monkeypatch):
        log.defer(Ending(PLAN, "finished", "goal reached"))

        def fail(_):
            raise OSError("broken")

        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", fail)
            for write in (log.flush, lambda: log.append(verdict())):
                with pytest.raises(RecordError):
                    write()
        log.flush()
        assert [record["record"] for record in lines(path)] == ["execution"]


class TestFailingDisk:
    def test_keeps_a_bounded_number_of_records_and_takes_no_verdict(self, log, path, monkeypatch):
        def fail(*_):
            raise OSError(errno.ENOSPC, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr(os, "write", fail)
            for number in range(KEPT + 7):
                if number == KEPT:
                    held = size(log)
                log.defer(verdict(f"p{number}", verdict="withdrawn"))
            assert size(log) < held + 7 and log.lost == 7
            for _ in range(2):
                with pytest.raises(RecordError, check=says("review.no_record")):
                    log.append(verdict("approved"))
        assert path.read_bytes() == b""

    def test_says_in_the_record_how_many_are_missing(self, log, path, monkeypatch):
        for number in range(KEPT + 7):
            log.defer(verdict(f"p{number}", verdict="withdrawn"))
        log.flush()
        log.append(verdict("next"))
        *kept, gap, following = lines(path)
        assert [record["plan"] for record in kept] == [f"p{number}" for number in range(KEPT)]
        assert (gap["record"], gap["lost"], following["plan"]) == ("gap", 7, "next")
        assert verify(path).lines == KEPT + 2 and log.lost == 7


class TestCommand:
    def test_prints_the_number_of_records_and_the_last_hash(self, written, capsys):
        assert main([str(written)]) == 0
        out = capsys.readouterr().out
        assert "5 records" in out and verify(written).head in out

    def test_names_the_first_broken_line(self, written, capsys):
        written.write_bytes(written.read_bytes().replace(b'"p2"', b'"p9"'))
        assert main([str(written)]) == 1
        assert "line 4" in capsys.readouterr().err
