"""The faults of `make soak ARGS=faults`: each is one thing that goes wrong, or that a person does, in the middle of a motion.

A fault leaves the robot as it may; the operator brings it back. It says itself which programs it ends and which lines of a log it
announces.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from construction_twin.msg import Execution, Link
from soak_operator import Operator
from soak_world import SoakWorld, wait_while

#: How long what must not move is watched [s].
WATCH = 3.0
#: What a program says, or roslaunch of it, when its neighbour is gone for a moment.
_NEIGHBOUR = (
    r"process has died", r"exit code -9", r"broker", r"MQTT", r"connection", r"Connection", r"does not answer", r"no gateway",
    r"NEEDS_RESET", r"silence", r"session",
)  # fmt: skip
_DISK = (r"No space left", r"record", r"disk", r"Logging error", r"Errno 28", r"ENOSPC")


@dataclass(frozen=True)
class Fault:
    """One kind of fault: what is done in the middle of a motion, which programs end by it, which log lines it announces."""

    name: str
    act: Callable[[Operator, SoakWorld], str]
    killed: frozenset[str] = frozenset()
    announces: tuple[str, ...] = ()
    #: It comes at rest, with a plan of its own.
    at_rest: bool = False
    #: The gate may close for it.
    causes_holds: bool = True


#: From the clock's step to the reset, whose moment counts too, at the most [s].
CAUGHT_UP = 20.0
#: More records than one page of a disk can hold.
_LINES_OF_A_PAGE = 12


def _watch(seconds: float = WATCH) -> None:
    """Let time pass in which nothing may happen: what does is the judge's to find."""
    time.sleep(seconds)


def _stop(route: str):
    def act(operator: Operator, _world: SoakWorld) -> str:
        operator.stop(route)
        _watch()
        return ""

    return act


def _stop_during_reset(operator: Operator, _world: SoakWorld) -> str:
    operator.stop("mqtt")
    operator.client.wait(lambda: operator.client.link.state == Link.NEEDS_RESET, "NEEDS_RESET", 10.0)
    answers: list[tuple[bool, str]] = []
    call = threading.Thread(target=lambda: answers.append(operator.reset()))
    call.start()
    late = operator.chance.uniform(0.0, 0.6)
    time.sleep(late)
    operator.stop("mqtt")
    call.join(20.0)
    _watch()
    return f"{1000 * late:.0f} ms after the call of reset, which said: {answers[0][1] if answers else 'nothing'}"


def _pause_and_resume(operator: Operator, _world: SoakWorld) -> str:
    first, second = (operator.chance.choice(("ros", "mqtt")) for _ in range(2))
    operator.pause(first)
    _watch(2.0)
    operator.resume(second)
    operator.client.wait(lambda: operator.client.execution.state != Execution.PAUSED, "the end of PAUSED", 5.0)
    return f"pause by {first}, resume by {second}"


def _late_resume(operator: Operator, _world: SoakWorld) -> str:
    old = operator.screen.moment
    operator.pause("mqtt")
    _watch(3.2)

    def ask() -> tuple[bool, str]:
        id_ = f"late-{time.monotonic_ns()}"
        topic = operator.topics.resume_by(operator.screen.account)
        operator.screen.client.publish(topic, json.dumps({"id": id_, "moment": old}), qos=1)
        heard = operator.screen.heard[operator.topics.pause_ack]

        def answers() -> list[dict]:
            found = [json.loads(payload) for payload, _ in list(heard)]
            return [answer for answer in found if answer["id"] == id_]

        operator.client.wait(answers, "the answer to a late resume", 10.0)
        return answers()[0]["ok"], answers()[0]["reason"]

    sentence = operator.refused("a resume whose moment is 3 s old", ask)
    _watch(1.0)
    operator.resume("ros")
    return sentence


def _reject(operator: Operator, _world: SoakWorld) -> str:
    plan = operator.plan()
    route = operator.chance.choice(("ros", "mqtt"))
    operator.reject(plan, route)
    operator.refused("an approval of a rejected plan", lambda: operator.approve(plan, "ros"))
    _watch()
    return f"by {route}"


def _late_approval(operator: Operator, _world: SoakWorld) -> str:
    old = operator.screen.moment
    plan = operator.plan()
    _watch(3.2)
    sentence = operator.refused("an approval whose moment is 3 s old", lambda: operator.approve(plan, "mqtt", old))
    _watch()
    return sentence


def _approval_held_back(operator: Operator, world: SoakWorld) -> str:
    plan = operator.plan()
    operator.shown(plan)
    answers: list[tuple[bool, str]] = []

    def ask() -> tuple[bool, str]:
        with world.frozen("mqtt_review"):
            call = threading.Thread(target=lambda: answers.append(operator.approve(plan, "mqtt")))
            call.start()
            time.sleep(operator.chance.uniform(3.3, 5.0))
        call.join(30.0)
        return answers[0]

    sentence = operator.refused("an approval that lay in a queue for over 3 s", ask)
    _watch()
    return sentence


def _two_approvals(operator: Operator, _world: SoakWorld) -> str:
    plan = operator.plan()
    operator.shown(plan)
    answers: list[tuple[bool, str]] = []
    calls = [
        threading.Thread(target=lambda route=route: answers.append(operator.approve(plan, route)))
        for route in ("ros", "mqtt")
    ]
    for call in calls:
        call.start()
    for call in calls:
        call.join(30.0)
    taken = sum(ok for ok, _ in answers)
    assert taken == 1, f"{taken} of two approvals at once were taken: {answers}"
    operator.wait_until_ended(plan.plan_id, plan.duration + 10.0)
    return "; ".join(sentence for ok, sentence in answers if not ok)


def _retained_verdict(operator: Operator, _world: SoakWorld) -> str:
    plan = operator.plan()
    operator.shown(plan)
    screen = operator.screen
    document = {"plan_id": plan.plan_id, "plan_hash": plan.plan_hash, "verdict": "approved", "moment": screen.moment}

    def ask() -> tuple[bool, str]:
        answer = screen.answer(json.dumps(document).encode(), retain=True)
        return answer["ok"], answer["reason"]

    try:
        sentence = operator.refused("a retained approval", ask)
    finally:
        screen.client.publish(operator.topics.review_by(screen.account), b"", qos=1, retain=True).wait_for_publish(5.0)
    _watch()
    return sentence


def _kill(name: str):
    def act(_operator: Operator, world: SoakWorld) -> str:
        before = world.kill(name)
        wait_while(lambda: world.nodes().get(name) in (None, before), 20.0)
        _watch()
        return ""

    return act


def _cut(operator: Operator, world: SoakWorld) -> str:
    seconds = operator.chance.choice((0.2, 0.8, 2.5, 6.0))
    world.cut(seconds)
    if breaks := operator.chance.random() < 0.3:
        world.break_connections()
    time.sleep(seconds)
    _watch(2.0)
    return f"{seconds:g} s" + (", connections broken" if breaks else "")


def _replies_lost(operator: Operator, _world: SoakWorld) -> str:
    share = operator.chance.choice((0.02, 0.1, 0.3))
    operator.client.inject("drop", value=[share], direction="to_controller")
    try:
        time.sleep(1.5)
    finally:
        operator.client.inject("drop", False, direction="to_controller")
    return f"{100 * share:g} % of the replies for 1.5 s"


def _override(operator: Operator, _world: SoakWorld) -> str:
    # corrections are not slower by it (docs/rsi.md): the plan that is under way, and another one, end as if nothing were
    counter, before = "controller_override_percent", operator.client.execution.plan_id
    operator.client.inject("override", value=[30.0])
    try:
        operator.client.wait(
            lambda: float(operator.client.gateway_counters().get(counter, "nan")) == 30.0, "30 % to be told", 5.0
        )
        operator.wait_until_ended(before)
        operator.play()
    finally:
        operator.client.inject("override", False)
    return ""


def _disk_full(operator: Operator, world: SoakWorld) -> str:
    with world.full_disk():
        operator.stop(operator.chance.choice(("ros", "mqtt")))
        _watch()
        # a full disk has room in the last page of each file: approvals that fit into it are recorded, and lawful
        for _ in range(_LINES_OF_A_PAGE):
            operator.back()
            plan = operator.plan()
            counted = operator.counted()
            ok, sentence = operator.approve(plan, "ros")
            if not ok:
                break
            operator.client.wait(operator.witness.arm.moves, "the arm to move", 5.0)
            operator.wait_until_ended(plan.plan_id)
        operator.note_refusal("an approval on a full disk", ok, sentence, counted)
        _watch()
    return sentence


def _clock_step(operator: Operator, world: SoakWorld) -> str:
    by, both = operator.chance.uniform(-10.0, 10.0), operator.chance.random() < 0.5
    world.step_clock(by, by if both else 0.0)
    time.sleep(0.1)
    stop = operator.chance.choice(("", "ros", "mqtt", "halt"))
    # a plan whose stamp may be of the clock as it was, before the stop or the reset, is void until the clock has caught up
    operator.void_until = time.monotonic() + max(0.0, -by) + CAUGHT_UP
    if stop:
        operator.stop(stop)
    _watch()
    said = f"to {by:+.2f} s, {'all programs' if both else 'the ROS nodes alone'}"
    return said + (f", then stop by {stop}" if stop else "")


FAULTS: tuple[Fault, ...] = (
    Fault("stop by ROS", _stop("ros")),
    Fault("stop by an account", _stop("mqtt")),
    Fault("stop at the gateway", _stop("control")),
    Fault("halt", _stop("halt")),
    Fault("stop during a reset", _stop_during_reset),
    Fault("pause and resume", _pause_and_resume),
    Fault("resume too late", _late_resume),
    Fault("rejection", _reject, at_rest=True),
    Fault("approval too late", _late_approval, at_rest=True),
    Fault("approval held back", _approval_held_back, at_rest=True),
    Fault("two approvals at once", _two_approvals, at_rest=True),
    Fault("retained approval", _retained_verdict, at_rest=True),
    *(
        Fault(f"kill {name}", _kill(name), frozenset({name}), _NEIGHBOUR)
        for name in ("broker", "mqtt_bridge", "pca_monitor", "executor", "planner", "rsi_gateway")
    ),
    Fault("MQTT cut", _cut, announces=_NEIGHBOUR),
    Fault("replies lost", _replies_lost),
    Fault("override 30 %", _override, causes_holds=False),
    Fault("disk full", _disk_full, announces=_DISK),
    Fault("clock step", _clock_step),
)
#: The gateway's trace holds an hour: a fault that begins a new one.
NEW_TRACE = next(fault for fault in FAULTS if fault.name == "kill rsi_gateway")
