"""What people do by MQTT, and the plan that they see before, without ROS master and broker."""

from __future__ import annotations

import json
import math
import sys
import threading
from types import SimpleNamespace

import pytest
import rospy
from bridge_bench import Client, Refusals
from construction_twin.msg import Link, Plan, PlanCaller, Rehearsal, Review
from construction_twin.srv import (
    ActAsSeenResponse,
    LimitSpeedResponse,
    ReviewPlanResponse,
    WorkDecideResponse,
)
from paho.mqtt.client import topic_matches_sub
from processes import wait_until
from rospy.exceptions import TransportTerminated

from construction_twin.core.freshness import Moment
from construction_twin.extensions.console.nodes import endpoint as module
from construction_twin.extensions.console.nodes.endpoint import Connection
from construction_twin.extensions.console.nodes.requests import WAITING, Acts, Services
from construction_twin.extensions.console.nodes.shown_plan import ShownPlan
from construction_twin.mqtt.client import Account, Broker
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import ANSWERS, PRESSED
from construction_twin.review.rehearsal_report import FAILED, PASSED, RehearsalReport, with_hash
from construction_twin.ros.messages.records import to_msg

#: The robot's account on a site.
SITE = Account(name="bridge.yaml")
STOP, PAUSE, RESUME, RESET, ARM = (kind.name for kind in PRESSED)
#: What starts something, and repeats a moment.
STARTING = (RESUME, RESET, ARM)
#: What the newest view said.
MOMENT = "c0ffee00-5000"


class Trigger:
    """In place of a service of the executor."""

    def __init__(self, verb, pressed):
        self.resolved_name = f"/kr120/{verb}"
        self._pressed = pressed
        self.error: Exception | None = None
        self.success, self.expired = True, False
        #: Set: the service answers.
        self.free = threading.Event()
        self.free.set()

    def __call__(self, **asked):
        assert self.free.wait(10.0)
        verb = self.resolved_name.rpartition("/")[2]
        person = asked.pop("person", None)
        assert asked == {"act": verb} | ({"moment": MOMENT} if verb in STARTING else {}) and person
        self._pressed.append(verb)
        if self.error is not None:
            raise self.error
        return ActAsSeenResponse(self.success, "as the executor says", self.expired, "")


class Later:
    """In place of a service of another node; `do` answers, once a test has put it there."""

    def __init__(self, name):
        self.resolved_name, self.do = f"/kr120/{name}", None

    def __call__(self, **asked):
        return self.do(**asked)


class Bench:
    """What people do, the plan that they see, a client that remembers, and an executor that says yes."""

    def __init__(self, account: Account | None = None):
        self.client, self.made, self.pressed = Client(), Refusals(None), []
        self.services = {verb: Trigger(verb, self.pressed) for verb in (STOP, PAUSE, *STARTING)}
        self.decide, self.limit_speed = Later("work/decide"), Later("limit_speed")
        self.connection = Connection(
            Broker("127.0.0.1", 1, account=account), self.client, Topics("twin", "kr120"), self.made.refuse
        )
        services = Services(self, self, self.services, self.decide, self.limit_speed)
        self.acts = Acts(self.connection, services)
        self.shown = ShownPlan(self.connection)

    resolved_name = "/kr120/review_plan"

    error: Exception | None = None

    #: What the executor has been asked, and what an approval waits for there.
    asked: list[dict] = []
    disk: threading.Event | None = None
    answer: ReviewPlanResponse | None = None

    def __call__(self, **request):
        if self.error is not None:
            raise self.error
        approves = request["approve"]
        if approves and self.disk is not None:
            assert self.disk.wait(10.0)
        self.asked = [*self.asked, request]
        said = "approved" if approves else "rejected"
        return self.answer or ReviewPlanResponse(True, said, False, "")

    def deliver(self, topic, payload, retain=False):
        """Hand over a message as the client does."""
        topic = f"twin/kr120/{topic}"
        (endpoint,) = (each for each in self.connection.endpoints if topic_matches_sub(each.topic, topic))
        endpoint.on_message(SimpleNamespace(topic=topic, payload=payload, retain=retain))

    def verdict(self, plan="p1", verdict="approved"):
        """A verdict on `review`."""
        content = {"plan_id": plan, "plan_hash": "cafe", "verdict": verdict, "reviewer": "Ann", "moment": MOMENT}
        self.deliver("review", json.dumps(content).encode())

    def carry_out(self, verdict="approved"):
        """A verdict that is carried out."""
        self.verdict(verdict=verdict)
        self.acts.queues["approve"].run()
        self.acts.queues["reject"].run()


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.setattr(rospy, "wait_for_service", lambda *_: None)
    monkeypatch.setattr(rospy, "loginfo", lambda *_: None)
    return Bench()


def test_more_verdicts_than_may_wait_are_refused_counted_and_answered(bench):
    bench.deliver("review", b"{")
    for _ in range(WAITING + 2):
        bench.verdict()
    answers = [json.loads(payload) for topic, payload in bench.client.published if topic.endswith("/ack")]
    assert bench.made.refused == {"format": 1, "busy": 2} and [answer["ok"] for answer in answers] == [False] * 3


def test_what_its_screen_had_shown_goes_to_the_executor_with_it_and_that_it_was_too_old_comes_back(bench):
    bench.answer = ReviewPlanResponse(False, "the approval is too old", True, "")
    bench.carry_out()
    answer = json.loads(bench.client.published[-1][1])
    assert [(asked["moment"], asked["approve"]) for asked in bench.asked] == [(MOMENT, True)]
    assert (answer["ok"], answer["expired"], answer["reason"]) == (False, True, "the approval is too old")


def test_on_a_site_a_verdict_in_no_name_is_refused_and_told_where_it_belongs(monkeypatch):
    monkeypatch.setattr(rospy, "wait_for_service", lambda *_: None)
    site = Bench(SITE)
    site.carry_out()
    answer = json.loads(site.client.published[-1][1])
    assert not answer["ok"] and "publish it on review/<account>" in answer["reason"]
    assert site.made.refused == {"sender": 1}


#: What is refused, and what its answer repeats all the same.
NAMED = {"plan_id": "p1", "plan_hash": "cafe", "verdict": "approved"}
REFUSED = [
    ("resume/bob", "pause/ack", {"id": "7"}, {"id": "7"}),
    ("reset/bob", "reset/ack", {"id": "7"}, {"id": "7"}),
    ("arm/bob", "arm/ack", {"id": "7", "moment": "now"}, {"id": "7"}),
    ("stop/bob", "stop/ack", {"id": "7", "more": 1}, {"id": "7"}),
    ("review/bob", "review/ack", NAMED, NAMED),
    ("review", "review/ack", NAMED | {"reviewer": "Ann"}, NAMED | {"reviewer": "Ann"}),
    ("review/bob", "review/ack", {"plan_id": "p1"}, {"plan_id": "p1", "plan_hash": ""}),
    ("review/bob", "review/ack", NAMED | {"plan_id": 5}, {"plan_id": "", "plan_hash": "cafe"}),
    ("override_rehearsal/bob", "override_rehearsal/ack", NAMED | {"moment": MOMENT}, NAMED),
    ("answer/bob", "answer/ack", {"id": "7", "task": "t"}, {"id": "7", "task": "t"}),
    ("lower_speed/bob", "speed/ack", {"id": "7", "limit": 0}, {"id": "7"}),
    ("raise_speed/bob", "speed/ack", {"id": "7", "limit": 0.9}, {"id": "7"}),
    ("resume/bob", "pause/ack", {"id": "x" * 65}, {"id": ""}),
    ("resume/bob", "pause/ack", ["7"], {"id": ""}),
]


@pytest.mark.parametrize("topic, ack, content, repeated", REFUSED)
@pytest.mark.parametrize("retain", [False, True])
def test_what_is_refused_is_answered_with_whatever_can_be_read_of_it(bench, topic, ack, content, repeated, retain):
    bench.deliver(topic, json.dumps(content).encode(), retain)
    (answer,) = acks(bench, ack.removesuffix("/ack"))
    assert not answer["ok"] and {name: answer[name] for name in repeated} == repeated


@pytest.mark.parametrize("account, reviewer", [("", "Ann"), ("kr120-reviewer-ada", "kr120-reviewer-ada")])
def test_the_answer_names_what_it_answers(bench, account, reviewer):
    verdict = {"plan_id": "p1", "plan_hash": "cafe", "verdict": "approved", "reviewer": "Ann"}
    bench.deliver(f"review/{account}" if account else "review", json.dumps(verdict | {"moment": MOMENT}).encode())
    bench.acts.queues["approve"].run()
    assert json.loads(bench.client.published[-1][1]) == verdict | {
        "reviewer": reviewer,
        "account": account,
        "ok": True,
        "reason": "approved",
        "expired": False,
    }


def reviews(bench):
    """Return the answers on review/ack."""
    return [json.loads(payload) for topic, payload in list(bench.client.published) if topic.endswith("review/ack")]


def test_a_rejection_does_not_wait_behind_an_approval_whose_record_waits_for_a_disk(bench, monkeypatch):
    ended, bench.disk = threading.Event(), threading.Event()
    monkeypatch.setattr(rospy, "is_shutdown", ended.is_set)
    bench.acts.start()
    bench.verdict("p1")
    bench.verdict("p1", "rejected")
    wait_until(lambda: [answer["reason"] for answer in reviews(bench)] == ["rejected"], what="the rejection's answer")
    bench.disk.set()
    wait_until(lambda: len(reviews(bench)) == 2, what="the approval's answer")
    ended.set()


def test_a_rejection_asks_no_master_while_the_connection_to_the_executor_stands(bench, monkeypatch):
    def no_master(name, timeout):
        raise rospy.ROSException(f"timeout exceeded while waiting for service {name}")

    monkeypatch.setattr(rospy, "wait_for_service", no_master)
    bench.carry_out("rejected")
    bench.carry_out()
    assert [answer["ok"] for answer in reviews(bench)] == [True, False]


def fail(*_given, **_named):
    raise RuntimeError("nobody foresaw this")


# -- stop, pause, resume


@pytest.fixture
def pressing(bench, monkeypatch):
    ended = threading.Event()
    monkeypatch.setattr(rospy, "is_shutdown", ended.is_set)
    bench.acts.start()
    yield bench
    ended.set()


def press(bench, verb, id_="1", account="kr120-stopper-bob", retain=False, payload=None, moment=MOMENT):
    if payload is None:
        payload = json.dumps({"id": id_} | ({"moment": moment} if verb in STARTING else {})).encode()
    bench.deliver(f"{verb}/{account}", payload, retain)


def acks(bench, name):
    found = [
        json.loads(payload) for topic, payload in list(bench.client.published) if topic == f"twin/kr120/{name}/ack"
    ]
    return found


@pytest.mark.parametrize("verb, ack", [("stop", "stop"), ("pause", "pause"), ("resume", "pause")])
def test_what_is_pressed_is_carried_out_and_answered(pressing, verb, ack):
    press(pressing, verb, "7")
    wait_until(lambda: acks(pressing, ack), what="an answer")
    assert acks(pressing, ack) == [
        {
            "id": "7",
            "account": "kr120-stopper-bob",
            "ok": True,
            "reason": "as the executor says",
            "by": "executor",
            "expired": False,
        }
    ]
    assert pressing.pressed == [verb]
    assert pressing.connection.status_fields() == {f"{verb} taken": 1}


@pytest.mark.parametrize("slow, quick", [(PAUSE, STOP), (RESET, STOP), (RESUME, PAUSE)])
def test_a_stop_waits_for_nothing_else_and_a_pause_for_no_resume(pressing, slow, quick):
    pressing.services[slow].free.clear()
    press(pressing, slow)
    press(pressing, quick, "2")
    wait_until(lambda: acks(pressing, quick), what="the answer to what is quick")
    assert pressing.pressed == [quick] and acks(pressing, quick)[0]["id"] == "2"
    pressing.services[slow].free.set()
    wait_until(lambda: pressing.pressed == [quick, slow], what="what waited")


@pytest.mark.parametrize("verb", [STOP, PAUSE])
def test_a_stop_asks_no_master_while_the_connection_to_the_executor_stands(pressing, monkeypatch, verb):
    def no_master(name, timeout):
        raise rospy.ROSException(f"timeout exceeded while waiting for service {name}")

    monkeypatch.setattr(rospy, "wait_for_service", no_master)
    press(pressing, verb)
    wait_until(lambda: acks(pressing, verb), what="an answer")
    assert acks(pressing, verb)[0]["ok"] and pressing.pressed == [verb]


@pytest.mark.parametrize("verb", [STOP, PAUSE])
def test_a_press_is_answered_although_the_log_fails_and_the_next_one_is_taken(pressing, monkeypatch, verb):
    monkeypatch.setattr(rospy, "loginfo", fail)
    for number in range(2):
        press(pressing, verb, str(number))
        wait_until(lambda: len(acks(pressing, verb)) > number, what="an answer")
        wait_until(
            lambda: pressing.connection.write_log() or pressing.connection.side_effects.counts()["the log"] > number
        )
    assert [answer["ok"] for answer in acks(pressing, verb)] == [True, True]
    assert pressing.connection.side_effects.counts() == {"the log": 2}


@pytest.mark.parametrize("verb", [STOP, PAUSE, "reject"])
def test_no_press_waits_for_the_log_of_the_one_before(pressing, monkeypatch, verb):
    """A disk or a terminal that hangs holds the log of a node up, for everybody who writes in it."""
    hangs = threading.Event()
    monkeypatch.setattr(rospy, "loginfo", lambda *words: hangs.wait(10.0))
    # the thread that writes may wait
    writer = threading.Thread(target=pressing.connection.write_log)
    for number in range(3):
        if verb == "reject":
            pressing.verdict(verdict="rejected")
            wait_until(lambda: len(reviews(pressing)) > number, what="an answer")
        else:
            press(pressing, verb, str(number))
            wait_until(lambda: len(acks(pressing, verb)) > number, what="an answer")
        if number == 0:
            writer.start()
    hangs.set()
    writer.join(10.0)


def test_a_resume_for_which_there_was_no_room_may_be_pressed_again(bench):
    for number in range(WAITING + 1):
        press(bench, "resume", str(number))
    assert [answer["ok"] for answer in acks(bench, "pause")] == [False] and bench.made.refused == {"busy": 1}
    bench.acts.start()
    wait_until(lambda: len(bench.pressed) == WAITING, what="those that waited")
    press(bench, "resume", str(WAITING))
    wait_until(lambda: len(bench.pressed) == WAITING + 1, what="the one that had no room")


@pytest.mark.parametrize("verb", [STOP, PAUSE])
def test_a_press_whose_answer_cannot_be_sent_is_carried_out_and_so_is_the_next_one(pressing, monkeypatch, verb):
    with monkeypatch.context() as broken:
        broken.setattr(pressing.client, "publish", fail)
        press(pressing, verb, "1")
        wait_until(lambda: pressing.connection.side_effects.counts() == {"the answer": 1}, what="the count")
    press(pressing, verb, "2")
    wait_until(lambda: acks(pressing, verb), what="an answer")
    assert pressing.pressed == [verb] * 2 and acks(pressing, verb)[0]["id"] == "2"


def test_a_resume_that_came_before_starts_nothing_again(pressing):
    answers = 0
    for verb, moment, id_ in (
        ("resume", MOMENT, "1"),
        ("pause", MOMENT, "1"),
        ("resume", "c0ffee00-9000", "1"),
        ("resume", MOMENT, "2"),
    ):
        press(pressing, verb, id_, moment=moment)
        answers += moment == MOMENT
        wait_until(lambda: len(acks(pressing, "pause")) == answers, what="its answer")
    assert pressing.pressed == ["resume", "pause", "resume"] and pressing.made.refused == {"repeated": 1}


@pytest.fixture
def hurried():
    """Threads that give way to each other at almost every step."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_what_starts_something_is_pressed_by_several_people_at_once(pressing, hurried):
    def go_on(verb):
        for number in range(150):
            press(pressing, verb, str(number), account=f"kr120-{verb}-bob")
            wait_until(lambda: pressing.pressed.count(verb) > number, what=f"{verb} {number}")

    people = [threading.Thread(target=go_on, args=(verb,)) for verb in STARTING]
    for person in people:
        person.start()
    for person in people:
        person.join()
    assert {verb: pressing.pressed.count(verb) for verb in STARTING} == dict.fromkeys(STARTING, 150)
    assert not pressing.made.refused


@pytest.mark.parametrize("verb", [STOP, PAUSE])
def test_a_stop_and_a_pause_are_carried_out_and_answered_as_often_as_they_come(pressing, verb):
    for _ in range(3):
        press(pressing, verb, "the same")
    wait_until(lambda: len(acks(pressing, verb)) == 3, what="three answers")
    assert pressing.pressed == [verb] * 3 and not pressing.made.refused


@pytest.mark.parametrize("verb, ack", [("stop", "stop"), ("pause", "pause"), ("resume", "pause")])
def test_what_is_no_press_is_refused_counted_and_answered(pressing, verb, ack):
    press(pressing, verb, payload=b"{}")
    press(pressing, verb, retain=True)
    press(pressing, verb, account="no account")
    assert pressing.made.refused == {"moment" if verb == RESUME else "format": 1, "retained": 1, "sender": 1}
    answers = acks(pressing, ack)
    assert [answer["ok"] for answer in answers] == [False] * 3
    assert [answer["account"] for answer in answers] == ["kr120-stopper-bob", "kr120-stopper-bob", ""]
    assert pressing.pressed == []


def test_who_floods_with_what_is_no_stop_is_not_always_answered_and_a_stop_is(pressing):
    for _ in range(100):
        press(pressing, STOP, payload=b"{}")
    answered = len(acks(pressing, STOP))
    assert ANSWERS <= answered < 100 and pressing.made.refused == {"format": 100}
    assert pressing.connection.status_fields() == {"stop not answered": 100 - answered}
    # nobody else's answers wait for that, and nothing that can be read does
    press(pressing, STOP, account="ada", payload=b"{}")
    press(pressing, STOP, "7")
    wait_until(lambda: len(acks(pressing, STOP)) == answered + 2, what="two answers")
    assert [(each["id"], each["ok"]) for each in acks(pressing, STOP)[-2:]] == [("", False), ("7", True)]


def test_answers_are_no_presses(pressing):
    press(pressing, "stop", account="ack")
    press(pressing, "pause", account="ack")
    assert not pressing.client.published and not pressing.made.refused


@pytest.mark.parametrize("error", [TransportTerminated("x"), rospy.ServiceException("x"), rospy.ROSException("x")])
def test_an_executor_that_is_not_there_is_told(pressing, error):
    pressing.services[STOP].error = error
    press(pressing, "stop")
    wait_until(lambda: acks(pressing, "stop"), what="an answer")
    answer = acks(pressing, "stop")[0]
    assert not answer["ok"] and "/kr120/stop does not answer" in answer["reason"]
    assert pressing.connection.status_fields() == {"stop not taken": 1}


def shown(bench) -> dict | None:
    """Return what screens see of the plan under review."""
    payload = [payload for topic, payload in bench.client.published if topic.endswith("/plan")][-1]
    return json.loads(payload) if payload else None


@pytest.mark.parametrize("first", ["plan", "caller"])
def test_a_screen_says_when_the_client_whose_plan_it_shows_is_gone(bench, first):
    plan = Plan(id="p1", hash="cafe", source="follow_joint_trajectory from /matlab")
    gone = PlanCaller(plan_id="p1", client="/matlab", connected=False)
    (bench.shown.on_plan if first == "plan" else bench.shown.on_caller)(plan if first == "plan" else gone)
    (bench.shown.on_caller if first == "plan" else bench.shown.on_plan)(gone if first == "plan" else plan)
    assert shown(bench)["source"] == (
        "follow_joint_trajectory from /matlab (connected no more: nobody waits for the result)"
    )
    bench.shown.on_caller(PlanCaller(plan_id="p1", client="/matlab", connected=True))
    assert shown(bench)["source"] == "follow_joint_trajectory from /matlab"
    bench.shown.on_caller(PlanCaller(plan_id="another", client="/x", connected=False))
    assert shown(bench)["source"] == "follow_joint_trajectory from /matlab"
    # a plan that was decided does not come back
    bench.shown.on_review(Review(plan_id="p1"))
    bench.shown.on_caller(gone)
    assert shown(bench) is None


def test_the_plan_under_review_is_shown_until_it_is_decided_or_void(bench):
    plan = bench.shown
    plan.on_plan(Plan(id="p1"))
    assert plan.plan == "p1" and shown(bench)["id"] == "p1"
    plan.on_review(Review(plan_id="p1"))
    assert plan.plan == "" and shown(bench) is None
    plan.on_link(Link(session="one"))
    plan.on_plan(Plan(id="p2"))
    plan.on_link(Link(session="one"))
    plan.on_link(Link(session=""))
    assert plan.plan == "p2"
    plan.on_link(Link(session="two"))
    assert plan.plan == "" and shown(bench) is None


# -- reset, arm, answers


@pytest.mark.parametrize("verb", [RESET, ARM])
def test_a_session_is_asked_for_in_the_name_of_the_account(pressing, verb):
    press(pressing, verb, "7", "ada")
    wait_until(lambda: acks(pressing, verb), what="an answer")
    (answer,) = acks(pressing, verb)
    assert (answer["ok"], answer["by"], answer["account"]) == (True, "bridge", "ada") and pressing.pressed == [verb]
    press(pressing, verb, "7", "ada")
    wait_until(lambda: pressing.made.refused == {"repeated": 1}, what="the refusal of the second")
    assert pressing.pressed == [verb], "QoS 1 may deliver twice"


def answering(bench, monkeypatch, now=5.0):
    """Let the bench's node have a work to answer to, and a clock."""
    asked = []

    def decide(**fields):
        asked.append(fields)
        return WorkDecideResponse(True, "T1: it stands at its place", "")

    bench.decide.do = decide
    monkeypatch.setattr(module, "present_moment", lambda: Moment("c0ffee00", round(now * 1e9)))
    return asked


ANSWER = {"id": "3", "task": "T1", "question": "where is it?", "answer": "placed", "moment": MOMENT}


def test_an_answer_goes_to_the_work_in_the_name_of_the_account(pressing, monkeypatch):
    asked = answering(pressing, monkeypatch)
    pressing.deliver("answer/ada", json.dumps(ANSWER).encode())
    wait_until(lambda: acks(pressing, "answer"), what="an answer")
    assert acks(pressing, "answer") == [
        {
            "id": "3",
            "account": "ada",
            "task": "T1",
            "ok": True,
            "reason": "T1: it stands at its place",
            "expired": False,
        }
    ]
    known = {"task": "T1", "question": "where is it?", "answer": "placed", "person": "ada"}
    assert asked == [{"decision": "answer", "reason": "by MQTT", **known}]


def test_an_answer_to_what_was_shown_long_ago_is_void(pressing, monkeypatch):
    asked = answering(pressing, monkeypatch, now=9.0)
    pressing.deliver("answer/ada", json.dumps(ANSWER).encode())
    wait_until(lambda: acks(pressing, "answer"), what="an answer")
    (answer,) = acks(pressing, "answer")
    assert (answer["ok"], answer["expired"], asked) == (False, True, [])
    assert pressing.made.refused == {"too_old": 1}


def limiting(bench, expired=False):
    """Let the bench's node have somebody who holds the speed limit."""
    asked, free = [], threading.Event()
    free.set()

    def limit_speed(**fields):
        if fields["moment"]:
            assert free.wait(10.0)
        asked.append(fields)
        return LimitSpeedResponse(not expired, "as pca_monitor says", expired, fields["limit"], "")

    bench.limit_speed.do = limit_speed
    return asked, free


def test_a_speed_limit_goes_on_in_the_name_of_the_account_and_is_answered(pressing):
    asked, _ = limiting(pressing)
    pressing.deliver("lower_speed/dora", json.dumps({"id": "7", "limit": 0.3, "moment": MOMENT}).encode())
    wait_until(lambda: acks(pressing, "speed"), what="an answer")
    answer = {
        "id": "7",
        "account": "dora",
        "limit": 0.3,
        "ok": True,
        "reason": "as pca_monitor says",
        "expired": False,
    }
    assert acks(pressing, "speed") == [answer]
    assert asked == [{"limit": 0.3, "person": "dora", "moment": ""}]
    assert pressing.connection.status_fields()["lower_speed taken"] == 1


def test_that_a_raise_was_too_old_comes_back(pressing):
    asked, _ = limiting(pressing, expired=True)
    pressing.deliver("raise_speed/dora", json.dumps({"id": "7", "limit": 0.9, "moment": MOMENT}).encode())
    wait_until(lambda: acks(pressing, "speed"), what="an answer")
    assert [(answer["ok"], answer["expired"]) for answer in acks(pressing, "speed")] == [(False, True)]
    assert asked[0]["moment"] == MOMENT


def test_a_lower_limit_waits_for_no_raise(pressing):
    asked, free = limiting(pressing)
    free.clear()
    pressing.deliver("raise_speed/dora", json.dumps({"id": "1", "limit": 0.9, "moment": MOMENT}).encode())
    pressing.deliver("lower_speed/dora", b'{"id": "2", "limit": 0.2}')
    wait_until(lambda: acks(pressing, "speed"), what="an answer")
    assert [fields["limit"] for fields in asked] == [0.2]
    free.set()


OVERRIDE = {
    "plan_id": "p1",
    "plan_hash": "cafe",
    "verdict": "approved",
    "moment": MOMENT,
    "reason": "seen by the crane's driver",
    "rehearsal_hash": "f00d",
}


def test_an_override_is_given_to_the_executor_in_the_name_of_its_account(bench):
    bench.deliver("override_rehearsal/kr120-lead-eva", json.dumps(OVERRIDE).encode())
    bench.acts.queues["approve"].run()
    (asked,) = bench.asked
    assert (asked["override_rehearsal"], asked["reviewer"], asked["approve"]) == (True, "kr120-lead-eva", True)
    assert asked["rehearsal_hash"] == "f00d"
    assert OVERRIDE["reason"] in asked["reason"]
    (answer,) = [json.loads(sent) for topic, sent in bench.client.published if topic.endswith("override_rehearsal/ack")]
    assert answer["ok"] and answer["account"] == "kr120-lead-eva"


def test_what_comes_on_review_overrides_nothing(bench):
    plain = {key: value for key, value in OVERRIDE.items() if key != "rehearsal_hash"}
    bench.deliver("review/kr120-reviewer-ada", json.dumps(plain).encode())
    bench.acts.queues["approve"].run()
    for more in ({"override_rehearsal": True}, {"rehearsal_hash": "f00d"}):
        bench.deliver("review/kr120-reviewer-ada", json.dumps(plain | more).encode())
        bench.acts.queues["approve"].run()
    (asked,) = bench.asked
    assert asked["override_rehearsal"] is False and bench.made.refused == {"format": 2}


def shown_rehearsals(bench) -> list[bytes]:
    return [payload for topic, payload in bench.client.published if topic == "twin/kr120/rehearsal"]


def rehearsed(**found) -> Rehearsal:
    return to_msg(with_hash(RehearsalReport(plan_id="p1", **found), 0.1), Rehearsal)


def test_a_rehearsal_whose_hash_is_not_its_own_is_refused_and_counted(bench):
    message = rehearsed(state=PASSED)
    message.plan_hash = "another"
    bench.shown.on_rehearsal(message)
    assert shown_rehearsals(bench) == [] and bench.made.refused == {"rehearsal": 1}


def test_what_a_rehearsal_has_found_is_shown_until_its_plan_is_decided(bench):
    bench.shown.on_rehearsal(rehearsed(state=FAILED, reasons=("too heavy",), tracking=math.nan))
    (shown,) = map(json.loads, shown_rehearsals(bench))
    assert (shown["plan_id"], shown["state"], shown["reasons"], shown["tracking"]) == (
        "p1",
        "failed",
        ["too heavy"],
        None,
    )
    bench.shown.on_review(Review(plan_id="another"))
    assert shown_rehearsals(bench)[-1] != b""
    bench.shown.on_review(Review(plan_id="p1"))
    assert shown_rehearsals(bench)[-1] == b""


def test_a_rehearsal_that_comes_after_the_verdict_is_not_shown(bench):
    bench.shown.on_review(Review(plan_id="p1"))
    bench.shown.on_rehearsal(rehearsed(state=PASSED))
    assert shown_rehearsals(bench)[-1] == b""
