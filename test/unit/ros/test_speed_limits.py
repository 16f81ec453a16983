"""What limits the speed, merged beside the gate, without a master: what is published, kept and refused."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from construction_twin.msg import SpeedLimit
from construction_twin.srv import LimitSpeedRequest
from executor_bench import ROBOT
from processes import wait_until
from unplugged import Unplugged

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.freshness import Moment
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.link.requests import LEAST_SPEED
from construction_twin.ros.nodes import pca_monitor
from construction_twin.ros.nodes.pca_monitor import PROGRAM
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN

BOOT = "c0ffee00"
RULES = {"speed_limit_deadline": 0.5, "speed_limit_silent": 0.1, "speed_limit_required": False, "arm": "mock"}
MONITOR = yaml.safe_load((Path(__file__).resolve().parents[3] / "config" / "pca_monitor.yaml").read_text())
GATEWAY = {"speed_limit_deadline": 0.5, "speed_limit_silent": 0.1, "speed_limit_grace": 0.5}


class Bench:
    """The monitor, started again as often as a test likes, on a clock of its own."""

    def __init__(self, monkeypatch, home, executor=RULES, gateway=GATEWAY, arm="mock"):
        self.now, self._patch, self.arm = 100.0, monkeypatch, arm
        patch = monkeypatch.setattr
        # the parameter server is the same for every node
        self.server = {"executor": executor, "gateway": gateway, PROGRAM: ""}
        self.file = home / "construction_twin" / "speed_limits" / f"{ROBOT.name}.json"
        monkeypatch.setenv("ROS_HOME", str(home))
        patch(pca_monitor.time, "monotonic_ns", lambda: round(self.now * NANOSECONDS))
        patch(pca_monitor, "now_ns", lambda: round(self.now * NANOSECONDS))
        patch(pca_monitor, "present_moment", lambda: Moment(BOOT, round(self.now * NANOSECONDS)))
        # what it records of its gate is another file, of which one process has one
        record = SimpleNamespace(add=lambda _: None, flush=lambda: None, fault="", values=dict)
        patch(pca_monitor, "TransitionLog", lambda *_: record)
        self.restart()

    def restart(self):
        settings = pca_monitor.Settings(arm=self.arm, decimals=3, servo_model="", **MONITOR)
        self.made = Unplugged(self._patch, pca_monitor.NODE, settings, ROBOT, parameters=self.server)
        self.speed = self.made.node.speed

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
        self.speed.repeat()

    @property
    def limit(self):
        assert self.sent, "nothing was published"
        return self.sent[-1].limit


@pytest.fixture
def bench(monkeypatch, tmp_path):
    return Bench(monkeypatch, tmp_path)


def test_a_program_s_limit_is_in_force_at_once_and_its_silence_counts_as_before(bench):
    bench.says(0.5)
    assert (bench.limit, bench.sent[-1].by) == (0.5, "program")
    assert bench.sent[-1].reason == "speed limit 0.5 by /kr120/separation: somebody is near"
    bench.later(0.5)
    assert bench.limit == 0.5
    bench.later(0.05)
    assert bench.limit == 0.1 and "silent for more than 0.5 s" in bench.sent[-1].reason
    assert bench.speed.diagnose().level == WARN
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


@pytest.mark.parametrize("node, value", [("executor", "soon"), ("gateway", -1.0)])
def test_what_is_no_rule_is_a_sentence_that_names_it(monkeypatch, tmp_path, node, value):
    with pytest.raises(ConfigurationError, match=f"{node}.*speed_limit_deadline.*{value}.*expected"):
        Bench(monkeypatch, tmp_path, **{node: {"speed_limit_deadline": value}})


def test_without_an_arm_there_is_no_gateway_to_ask_and_no_file(monkeypatch, tmp_path):
    bench = Bench(monkeypatch, tmp_path, gateway=None, arm="none")
    assert bench.sets(0.3).success and bench.limit == 0.3 and not bench.file.exists()


def test_what_no_program_may_say_is_refused_and_counted(bench):
    bench.says(0.5)
    for limit, source in ((2.0, "/kr120/separation"), (float("nan"), "/kr120/separation"), (0.7, "/other"), (0.7, "")):
        bench.says(limit, source)
    reasons = [reason for reason, _ in bench.made.refused]
    assert reasons == ["speed_limit", "speed_limit", "speed_limit_source", "speed_limit_source"] and bench.limit == 0.5


def test_each_limit_that_a_person_has_set_is_told_for_the_record(bench):
    bench.sets(0.3)
    bench.later(1.0)
    bench.sets(0.6, "bob", bench.shown())
    # the same again, and what is refused, has changed nothing
    bench.sets(0.6, "ada")
    assert bench.sets(0.9, "ada").limit == 0.6 and [reason for reason, _ in bench.made.refused] == ["direction"]
    told = bench.made.published["speed_change"]
    assert [(each.person, each.limit, each.before, each.whose, each.stamp.to_sec()) for each in told] == [
        ("dora", 0.3, 1.0, "", 100.0),
        ("bob", 0.6, 0.3, "dora", 101.0),
    ]


class Disk:
    """A disk that hangs at each write while it is blocked."""

    def __init__(self, monkeypatch):
        self.works, self.asked = threading.Event(), threading.Event()
        write = os.write

        def hang(*given):
            self.asked.set()
            return self.works.wait(30.0) and write(*given)

        monkeypatch.setattr(os, "write", hang)


def test_the_answer_to_a_lower_limit_waits_for_a_disk_that_is_quick_and_not_for_one_that_hangs(bench, monkeypatch):
    """So a kill right behind the answer raises nothing, and one lower limit holds up no other."""
    monkeypatch.setattr(pca_monitor, "PATIENCE", 30.0)
    assert bench.sets(0.3).success and json.loads(bench.file.read_text())["limit"] == 0.3
    disk = Disk(monkeypatch)
    monkeypatch.setattr(pca_monitor, "PATIENCE", 0.05)
    assert bench.sets(0.2).success and bench.sets(0.1).success and bench.limit == 0.1
    disk.works.set()
    wait_until(lambda: json.loads(bench.file.read_text())["limit"] == 0.1, what="the newest limit on the disk")


def test_while_a_raise_waits_for_the_disk_setpoints_sync_and_lower_limits_go_on(bench, monkeypatch):
    bench.sets(0.5)
    bench.later(1.0)
    disk = Disk(monkeypatch)
    monkeypatch.setattr(pca_monitor, "PATIENCE", 0.0)
    answers = []
    raising = threading.Thread(target=lambda: answers.append(bench.sets(0.8, moment=bench.shown())))
    raising.start()
    assert disk.asked.wait(30.0)

    def cycle():
        for _ in range(100):
            bench.now += CYCLE_NS / NANOSECONDS
            stamp = round(bench.now * NANOSECONDS)
            bench.made.callbacks["twin/joint_states"](stamp, ROBOT.home)
            bench.made.callbacks["next/joint_states"](stamp, ROBOT.home)
        bench.made.node.watch()
        bench.says(0.4)
        bench.sets(0.3, "bob")
        bench.later(0.05)

    cycling = threading.Thread(target=cycle, daemon=True)
    cycling.start()
    cycling.join(30.0)
    assert not cycling.is_alive() and bench.made.published["sync"] and (bench.limit, answers) == (0.3, [])
    disk.works.set()
    raising.join(30.0)
    assert (answers[0].success, bench.limit) == (False, 0.3), "somebody has lowered it meanwhile"
    wait_until(lambda: json.loads(bench.file.read_text())["limit"] == 0.3, what="the limit in force on the disk")


def test_before_anybody_limits_nothing_is_published_and_a_slow_program_is_told_of_beside_the_gate(bench):
    bench.later(1.0)
    assert bench.sent == [] and bench.made.diagnose().values["speed limit"] == "1.000"
    bench.says(0.5)
    bench.later(1.0)
    report = bench.made.diagnose()
    assert report.level == WARN and "/kr120/separation is silent" in report.sentence


def test_what_people_set_outlasts_node_and_launch(bench):
    bench.sets(0.3)
    bench.speed.write()
    bench.server[PROGRAM] = ""
    bench.restart()
    bench.later(0.05)
    assert (bench.limit, bench.sent[-1].person) == (0.3, "dora")
    bench.later(1.0)
    bench.sets(1.0, moment=bench.shown())
    bench.speed.write()
    bench.restart()
    bench.later(0.05)
    assert (bench.limit, bench.sent[-1].by) == (1.0, ""), "a gateway that had a lower one must hear that it is over"


def test_a_raise_is_on_the_disk_before_it_is_in_force(bench, monkeypatch):
    bench.sets(0.3)
    bench.speed.write()
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
    bench.speed.write()
    full(monkeypatch, bench.file)
    bench.sets(0.06, "a person with a long name")
    bench.speed.write()
    bench.restart()
    bench.later(0.05)
    assert (bench.limit, bench.sent[-1].person) == (0.06, "a person with a long name")
    assert bench.speed.diagnose().level == OK


@pytest.mark.parametrize("call", ["open", "write", "fsync"])
def test_what_cannot_be_written_at_all_is_obeyed_only_falls_and_is_not_known_after_a_restart(bench, monkeypatch, call):
    def fail(*_):
        raise OSError(5, "Input/output error")

    bench.sets(0.5)
    bench.speed.write()
    bench.later(1.0)
    with monkeypatch.context() as broken:
        broken.setattr(os, call, fail)
        assert bench.sets(0.06).success and bench.limit == 0.06
        bench.speed.write()
        report = bench.speed.diagnose()
        assert report.level == ERROR and "Input/output error" in report.sentence
        bench.later(1.0)
        answer = bench.sets(0.5, moment=bench.shown())
        assert (answer.success, answer.limit, bench.limit) == (False, 0.06, 0.06)
        assert [reason for reason, _ in bench.made.refused] == ["file"]
    bench.restart()
    bench.later(0.05)
    assert bench.limit == LEAST_SPEED and bench.speed.diagnose().level == ERROR


def test_a_raise_that_is_overtaken_while_it_is_written_is_void_also_on_the_disk(bench, monkeypatch):
    bench.sets(0.3)
    bench.speed.write()
    bench.later(1.0)
    write, seen = os.write, bench.shown()
    monkeypatch.setattr(pca_monitor, "PATIENCE", 0.0)

    def overtaken(*given):
        monkeypatch.setattr(os, "write", write)
        bench.sets(0.1, "bob")
        return write(*given)

    monkeypatch.setattr(os, "write", overtaken)
    answer = bench.sets(0.8, moment=seen)
    assert (answer.success, answer.expired, answer.limit, bench.limit) == (False, True, 0.1, 0.1)
    assert [reason for reason, _ in bench.made.refused] == ["too_old"]
    bench.speed.write()
    assert json.loads(bench.file.read_text())["limit"] == 0.1


@pytest.mark.parametrize("contents", [None, b"", b"\xff", b'{"limit": 5}', b"x" * (1 << 17)])
def test_a_file_that_cannot_be_read_is_the_least_until_a_person_sets_another(bench, contents):
    bench.sets(0.3)
    bench.speed.write()
    bench.file.unlink() if contents is None else bench.file.write_bytes(contents)
    bench.restart()
    bench.later(1.0)
    assert bench.limit == LEAST_SPEED and bench.speed.diagnose().level == ERROR
    bench.speed.write()
    assert contents is None or bench.file.read_bytes() == contents, "what it was stays to be looked at"
    assert bench.sets(0.5, moment=bench.shown()).success
    bench.speed.write()
    assert bench.limit == 0.5 and json.loads(bench.file.read_text())["limit"] == 0.5


@pytest.mark.parametrize("said, holds", [(0.7, 0.1), (0.05, 0.05), (0.0, 0.0)])
def test_a_program_that_was_heard_counts_as_silent_in_the_monitor_after_this_one(bench, said, holds):
    bench.says(said)
    bench.later(0.05)
    wait_until(lambda: bench.server[PROGRAM] == f"{holds:g} /kr120/separation", what="the memory")
    bench.restart()
    bench.later(0.05)
    assert bench.limit == holds and "silent" in bench.sent[-1].reason
    # it is not taken for one that is heard: another one may come
    bench.says(0.9, "/other")
    assert bench.limit == 0.9
