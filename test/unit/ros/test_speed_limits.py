"""The node that merges what limits the speed, without a master: what it publishes, keeps and refuses."""

from __future__ import annotations

import json
import os
import threading
from types import SimpleNamespace

import pytest
import rospy
from construction_twin.msg import SpeedLimit
from construction_twin.srv import LimitSpeedRequest
from executor_bench import ROBOT
from processes import wait_until
from unplugged import Unplugged

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.freshness import Moment
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.speed_limits import LEAST
from construction_twin.ros.nodes import speed_limits as module
from construction_twin.ros.nodes.speed_limits import NODE, PROGRAM, Settings
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN

BOOT = "c0ffee00"
RULES = {"speed_limit_deadline": 0.5, "speed_limit_silent": 0.1, "speed_limit_required": False, "arm": "mock"}
GATEWAY = {"speed_limit_deadline": 0.5, "speed_limit_silent": 0.1, "speed_limit_grace": 0.5}


class Bench:
    """The node, started again as often as a test likes, on a clock of its own."""

    def __init__(self, monkeypatch, home, executor=RULES, gateway=GATEWAY, arm="mock"):
        self.now, self._patch, self.arm = 100.0, monkeypatch, arm
        patch = monkeypatch.setattr
        # the parameter server is the same for every node
        self.server = {"executor": executor, "gateway": gateway, PROGRAM: ""}
        self.file = home / "limits" / f"{ROBOT.name}.json"
        monkeypatch.setenv("ROS_HOME", str(home))
        patch(module.time, "monotonic_ns", lambda: round(self.now * NANOSECONDS))
        # no thread writes here, but `write`
        patch(module, "PATIENCE", 0.0)
        patch(module, "now_ns", lambda: round(self.now * NANOSECONDS))
        patch(module, "present", lambda: Moment(BOOT, round(self.now * NANOSECONDS)))
        for name in ("loginfo", "logwarn", "logerr_throttle"):
            patch(rospy, name, lambda *_: None)
        self.restart()

    def restart(self):
        settings = Settings(arm=self.arm, folder="limits")
        self.made = Unplugged(self._patch, NODE, settings, ROBOT, parameters=self.server)
        self.node = self.made.node

    @property
    def sent(self):
        return self.made.published["speed_limit_in_force"]

    def says(self, limit, source="/kr120/separation", reason="somebody is near"):
        message = SpeedLimit(limit=limit, reason=reason)
        message._connection_header = {"callerid": source}
        self.made.callbacks["speed_limit"](message)

    def sets(self, limit, person="dora", moment=""):
        return self.made.services["limit_speed"](LimitSpeedRequest(limit=limit, person=person, moment=moment))

    def shown(self):
        """The moment of a view that shows the present."""
        return str(Moment(BOOT, round(self.now * NANOSECONDS)))

    def later(self, seconds):
        self.now += seconds
        self.made.timers[0](SimpleNamespace())

    @property
    def limit(self):
        assert self.sent, "nothing was published"
        return self.sent[-1].limit


@pytest.fixture
def bench(monkeypatch, tmp_path):
    return Bench(monkeypatch, tmp_path)


def test_nothing_is_published_before_anybody_limits(bench):
    bench.later(1.0)
    assert bench.sent == [] and bench.node.report().level == OK


def test_a_program_s_limit_is_in_force_at_once_and_its_silence_counts_as_before(bench):
    bench.says(0.5)
    assert (bench.limit, bench.sent[-1].by) == (0.5, "program")
    assert bench.sent[-1].reason == "speed limit 0.5 by /kr120/separation: somebody is near"
    bench.later(0.5)
    assert bench.limit == 0.5
    bench.later(0.05)
    assert bench.limit == 0.1 and "silent for more than 0.5 s" in bench.sent[-1].reason
    assert bench.node.report().level == WARN
    bench.says(1.0)
    assert (bench.limit, bench.sent[-1].by) == (1.0, "")


def test_the_lowest_of_program_and_people_is_in_force_and_repeated(bench):
    bench.says(0.5)
    assert bench.sets(0.3).success and bench.limit == 0.3
    bench.says(0.2)
    assert (bench.limit, bench.sent[-1].people, bench.sent[-1].person) == (0.2, 0.3, "dora")
    before = len(bench.sent)
    for _ in range(5):
        bench.later(0.05)
    assert [message.limit for message in bench.sent[before:]] == [0.2] * 5


def test_executor_and_gateway_are_kept_to_the_stricter_of_what_each_was_told(monkeypatch, tmp_path):
    gateway = GATEWAY | {"speed_limit_deadline": 0.3, "speed_limit_silent": 0.05}
    bench = Bench(monkeypatch, tmp_path, gateway=gateway)
    bench.says(0.5)
    bench.later(0.31)
    assert bench.limit == 0.05


def test_without_an_arm_there_is_no_gateway_to_ask_and_no_file(monkeypatch, tmp_path):
    bench = Bench(monkeypatch, tmp_path, gateway=None, arm="none")
    bench.sets(0.3)
    bench.node.write()
    assert bench.limit == 0.3 and not bench.file.exists()


def test_parameters_of_the_executor_that_make_no_sense_end_the_node_with_a_sentence(monkeypatch, tmp_path):
    with pytest.raises(ConfigurationError, match="speed_limit_silent"):
        Bench(monkeypatch, tmp_path, executor=RULES | {"speed_limit_silent": 2.0})


def test_what_no_program_may_say_is_refused_and_counted(bench):
    bench.says(0.5)
    for limit, source in ((2.0, "/kr120/separation"), (float("nan"), "/kr120/separation"), (0.7, "/other"), (0.7, "")):
        bench.says(limit, source)
    reasons = [reason for reason, _ in bench.made.refused]
    assert reasons == ["speed_limit", "speed_limit", "speed_limit_source", "speed_limit_source"] and bench.limit == 0.5


def test_raising_is_sent_with_a_moment_and_names_whose_limit_it_replaces(bench):
    bench.sets(0.3)
    bench.later(1.0)
    answer = bench.sets(0.6, "bob")
    assert not answer.success and not answer.expired and answer.limit == 0.3
    answer = bench.sets(0.6, "bob", bench.shown())
    assert answer.success and answer.limit == 0.6 and "dora" in answer.message
    last = bench.sent[-1]
    assert (last.limit, last.person, last.replaced, last.replaced_person) == (0.6, "bob", 0.3, "dora")
    assert bench.node.report().values["replaced was set by"] == "dora"
    assert [reason for reason, _ in bench.made.refused] == ["moment"]


def test_each_limit_that_a_person_has_set_is_told_for_the_record(bench):
    bench.sets(0.3)
    bench.later(1.0)
    bench.sets(0.6, "bob", bench.shown())
    # the same again, and what is refused, has changed nothing
    bench.sets(0.6, "ada")
    bench.sets(0.9, "ada")
    told = bench.made.published["speed_change"]
    assert [(each.person, each.limit, each.before, each.whose, each.stamp.to_sec()) for each in told] == [
        ("dora", 0.3, 1.0, "", 100.0),
        ("bob", 0.6, 0.3, "dora", 101.0),
    ]


def test_a_raise_that_is_too_old_is_refused_counted_and_said(bench):
    bench.sets(0.3)
    bench.later(1.0)
    seen = bench.shown()
    bench.later(3.1)
    answer = bench.sets(0.6, moment=seen)
    assert (answer.success, answer.expired, answer.limit, bench.limit) == (False, True, 0.3, 0.3)
    assert [reason for reason, _ in bench.made.refused] == ["too_old"]


def test_lowering_is_in_force_before_a_disk_is_asked(bench, monkeypatch):
    monkeypatch.setattr(os, "write", lambda *_: pytest.fail("the answer waited for a disk"))
    assert bench.sets(0.3).success and bench.limit == 0.3


def test_the_answer_to_a_lower_limit_waits_for_a_disk_that_is_quick_and_not_for_one_that_hangs(bench, monkeypatch):
    """So a kill right behind the answer raises nothing, and one lower limit holds up no other."""
    monkeypatch.setattr(module, "PATIENCE", 10.0)
    running = threading.Event()
    monkeypatch.setattr(rospy, "is_shutdown", running.is_set)
    threading.Thread(target=bench.node.run, daemon=True).start()
    bench.sets(0.3)
    assert json.loads(bench.file.read_text())["limit"] == 0.3
    hangs = threading.Event()
    write = os.write
    monkeypatch.setattr(os, "write", lambda *given: hangs.wait(30.0) and write(*given))
    monkeypatch.setattr(module, "PATIENCE", 0.05)
    assert bench.sets(0.2).success and bench.sets(0.1).success and bench.limit == 0.1
    hangs.set()
    wait_until(lambda: json.loads(bench.file.read_text())["limit"] == 0.1, what="the newest limit on the disk")
    running.set()


def test_what_people_set_outlasts_node_and_launch(bench):
    bench.sets(0.3)
    bench.node.write()
    bench.server[PROGRAM] = ""
    bench.restart()
    bench.later(0.05)
    assert (bench.limit, bench.sent[-1].person) == (0.3, "dora")
    bench.later(1.0)
    bench.sets(1.0, moment=bench.shown())
    bench.node.write()
    bench.restart()
    bench.later(0.05)
    assert (bench.limit, bench.sent[-1].by) == (1.0, ""), "a gateway that had a lower one must hear that it is over"


def test_a_raise_is_on_the_disk_before_it_is_in_force(bench, monkeypatch):
    bench.sets(0.3)
    bench.node.write()
    bench.later(1.0)
    write = os.write
    with monkeypatch.context() as watched:
        watched.setattr(os, "write", lambda *given: bench.limit == 0.3 and write(*given))
        assert bench.sets(0.8, moment=bench.shown()).success and bench.limit == 0.8
    bench.restart()
    bench.later(0.05)
    assert bench.limit == 0.8


def full(monkeypatch, path):
    """Let the disk be full: what has its room can be written in place, anything else has none."""
    has = os.stat(path).st_size if path.exists() else -1
    opens, writes = os.open, os.write

    def open_(name, flags, *more, **named):
        if flags & os.O_CREAT and not os.path.exists(name):
            raise OSError(28, "No space left on device")
        return opens(name, flags, *more, **named)

    def write(file, data):
        if len(data) > has:
            raise OSError(28, "No space left on device")
        return writes(file, data)

    monkeypatch.setattr(os, "open", open_)
    monkeypatch.setattr(os, "write", write)


def test_on_a_full_disk_a_restart_raises_nothing(bench, monkeypatch):
    bench.sets(0.5)
    bench.node.write()
    full(monkeypatch, bench.file)
    bench.sets(0.06, "a person with a long name")
    bench.node.write()
    bench.restart()
    bench.later(0.05)
    assert (bench.limit, bench.sent[-1].person) == (0.06, "a person with a long name")
    assert bench.node.report().level == OK


def test_a_first_limit_on_a_disk_that_was_full_from_the_start_is_the_least(monkeypatch, tmp_path):
    with monkeypatch.context() as patch:
        full(patch, tmp_path / "nothing")
        bench = Bench(patch, tmp_path)
        bench.later(1.0)
        assert bench.limit == LEAST and bench.node.report().level == ERROR
        answer = bench.sets(0.5, moment=bench.shown())
        assert not answer.success and "No space left" in answer.message and answer.limit == LEAST
        bench.restart()
        bench.later(1.0)
        assert bench.limit == LEAST


@pytest.mark.parametrize("call", ["open", "write", "fsync"])
def test_what_cannot_be_written_at_all_is_obeyed_only_falls_and_is_not_known_after_a_restart(bench, monkeypatch, call):
    def fail(*_):
        raise OSError(5, "Input/output error")

    bench.sets(0.5)
    bench.node.write()
    bench.later(1.0)
    with monkeypatch.context() as broken:
        broken.setattr(os, call, fail)
        assert bench.sets(0.06).success and bench.limit == 0.06
        bench.node.write()
        report = bench.node.report()
        assert report.level == ERROR and "Input/output error" in report.sentence
        bench.later(1.0)
        answer = bench.sets(0.5, moment=bench.shown())
        assert (answer.success, answer.limit, bench.limit) == (False, 0.06, 0.06)
        assert [reason for reason, _ in bench.made.refused] == ["file"]
    bench.restart()
    bench.later(0.05)
    assert bench.limit == LEAST and bench.node.report().level == ERROR


def test_a_raise_that_is_overtaken_while_it_is_written_is_void_also_on_the_disk(bench, monkeypatch):
    bench.sets(0.3)
    bench.node.write()
    bench.later(1.0)
    write, seen = os.write, bench.shown()

    def overtaken(*given):
        monkeypatch.setattr(os, "write", write)
        bench.sets(0.1, "bob")
        return write(*given)

    monkeypatch.setattr(os, "write", overtaken)
    answer = bench.sets(0.8, moment=seen)
    assert (answer.success, answer.expired, bench.limit) == (False, True, 0.1)
    bench.node.write()
    assert json.loads(bench.file.read_text())["limit"] == 0.1


def test_a_file_that_is_missing_where_one_was_is_the_least(bench):
    bench.node.write()
    bench.file.unlink()
    bench.restart()
    bench.later(0.05)
    assert bench.limit == LEAST and bench.node.report().level == ERROR


@pytest.mark.parametrize("contents", [b"", b"\xff", b'{"limit": 5}', b"x" * (1 << 17)])
def test_a_file_that_cannot_be_read_is_the_least_until_a_person_sets_another(bench, contents):
    bench.sets(0.3)
    bench.node.write()
    bench.file.write_bytes(contents)
    bench.restart()
    bench.later(1.0)
    assert bench.limit == LEAST and bench.node.report().level == ERROR
    bench.node.write()
    assert bench.file.read_bytes() == contents, "what it was stays to be looked at"
    assert bench.sets(0.5, moment=bench.shown()).success
    bench.node.write()
    assert bench.limit == 0.5 and json.loads(bench.file.read_text())["limit"] == 0.5


def test_a_file_that_cannot_be_written_is_said_and_tried_again(bench, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr(os, "write", fail)
        bench.sets(0.3)
        bench.node.write()
        report = bench.node.report()
        assert report.level == ERROR and "No space left" in report.sentence and bench.limit == 0.3
    bench.node.write()
    assert bench.node.report().level == OK and json.loads(bench.file.read_text())["limit"] == 0.3


def test_a_program_that_was_heard_counts_as_silent_in_the_node_after_this_one(bench):
    bench.says(0.05)
    bench.later(0.05)
    wait_until(lambda: bench.server[PROGRAM] == "0.05 /kr120/separation", what="the memory")
    bench.restart()
    bench.later(0.05)
    assert bench.limit == 0.05 and "silent" in bench.sent[-1].reason
    bench.says(0.9)
    assert bench.limit == 0.9
