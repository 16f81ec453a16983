"""The person of `make soak ARGS=faults`: plans, approves, stops, resets, by ROS and at a screen, and notes what was asked when.

Nothing is decided here about right or wrong: answers are noted, and what a person would do next is done.
"""

from __future__ import annotations

import contextlib
import json
import random
import time
import uuid
from collections.abc import Callable
from pathlib import Path

import rospy
from construction_twin.msg import Execution, Link, Sync
from construction_twin.srv import ReviewPlan
from soak_judge import Permission, Refusal, Stop
from soak_witness import Witness
from tablet import Tablet
from twin_client import HOME, LEFT, RIGHT, TwinClient

from construction_twin.core.freshness import parse_moment
from construction_twin.core.units import NANOSECONDS
from construction_twin.mqtt.messages import Control, Topics

#: Where the arm is sent [deg], far enough from each other for a motion of seconds.
POSES = (HOME, LEFT, RIGHT, (50.0, -70.0, 60.0, -30.0, 60.0, 80.0), (-45.0, -85.0, 75.0, 40.0, 80.0, -60.0))
#: Length of a motion in which a fault comes [s].
DURATION = (4.0, 8.0)
#: How a verdict, a stop, a pause is given.
ROUTES = ("ros", "mqtt")
#: What a person sees when a service is gone, or a wait was in vain.
FAILURES = (AssertionError, rospy.ServiceException, rospy.ROSException)
#: Longest time in which a person brings the robot back [s].
BACK = 90.0
ACCOUNT = "anna"


class Operator:
    """Parameters: the client's namespace is the robot's; `folder` takes the screen's account; `broker_port` is the broker's own."""

    def __init__(self, witness: Witness, folder: Path, broker_port: int, chance: random.Random):
        self.client, self.witness, self.chance = TwinClient(), witness, chance
        self.topics = Topics("twin", "kr120")
        account = folder / "anna.json"
        (folder / "password").write_text("not checked by a broker without accounts\n")
        (folder / "password").chmod(0o600)
        account.write_text(json.dumps({"user": ACCOUNT, "password_file": "password"}))
        self.screen = Tablet(account, broker_port, self.topics)
        self.permissions: list[Permission] = []
        self.refusals: list[Refusal] = []
        #: Until then a plan may be void because a clock was set back.
        self.void_until = 0.0
        self._stops: list[tuple[str, float, bool]] = []
        self._undone: list[float] = []

    # -- what a person does

    def plan(self, duration: float | None = None):
        """Have a motion planned to a pose drawn from `POSES`, somewhere else than the arm is; return its plan."""
        here = self.witness.arm.pose
        goals = [pose for pose in POSES if max(abs(q - p) for q, p in zip(self.client.si(pose), here)) > 0.2]
        length = self.chance.uniform(*DURATION) if duration is None else duration
        return self.client.plan_to(self.chance.choice(goals), length)

    def approve(self, plan, route: str = "", moment: str = "") -> tuple[bool, str]:
        """Approve a plan by a route, "" for any; at the screen with its newest moment, or another one. Return the answer."""
        route = route or self.chance.choice(ROUTES)
        if route == "ros":
            ok, sentence, seen = self._approve_by_ros(plan)
        else:
            shown = self.shown(plan)
            given = moment or self.screen.moment
            seen = self._monotonic(given)
            answer = self.screen.verdict(shown, "approved", moment=given)
            ok, sentence = answer["ok"], answer["reason"]
        if ok:
            self.permissions.append(Permission(plan.plan_id, seen))
        return ok, sentence

    def _approve_by_ros(self, plan) -> tuple[bool, str, float]:
        service = rospy.ServiceProxy("review_plan", ReviewPlan)
        deadline = time.monotonic() + 5.0
        while True:
            asked = time.monotonic()
            answer = service(plan.plan_id, plan.plan_hash, True, "soak", "", False, "")
            # the plan travels on a topic of its own
            if answer.success or "is not under review" not in answer.message or time.monotonic() > deadline:
                return answer.success, answer.message, asked
            time.sleep(0.02)

    def start(self, duration: float | None = None):
        """Plan, approve by any route, wait until the arm moves; return the plan. One that is void for a clock is planned again."""
        while True:
            plan = self.plan(duration)
            # a plan that is void is on no screen
            ok, sentence = self.approve(plan, "ros" if time.monotonic() < self.void_until else "")
            if ok or "is not under review" not in sentence or time.monotonic() > self.void_until:
                break
        assert ok, f"an approval was refused: {sentence}"
        self.client.wait(self.witness.arm.moves, "the arm to move", 5.0)
        return plan

    def shown(self, plan) -> dict:
        """Wait until the screen shows a plan, and a view that is not old; return what it shows of the plan."""
        self.client.wait(lambda: (self.screen.plan or {}).get("id") == plan.plan_id, "the plan on the screen")
        self.client.wait(lambda: time.monotonic() - self._monotonic(self.screen.moment) < 0.5, "a fresh view")
        return self.screen.plan

    def play(self) -> bool:
        """A motion from plan to end, as on any day; return whether it was finished. When it is not, the robot is brought back."""
        plan = self.start()
        self.wait_until_ended(plan.plan_id, plan.duration + 10.0)
        finished = self.client.execution.outcome == "finished"
        self.back()
        return finished

    def plays(self, plan_id: str) -> bool:
        """Return whether a plan is being played."""
        report = self.client.execution
        return (report.plan_id, report.state) == (plan_id, Execution.PLAYING)

    def wait_until_ended(self, plan_id: str, timeout: float = 20.0) -> None:
        """Wait until a plan is not played any more, whatever the outcome."""

        def ended() -> bool:
            report = self.client.execution
            return report.plan_id == plan_id and report.state in (Execution.IDLE, Execution.WAITING)

        self.client.wait(ended, f"the end of plan {plan_id}", timeout)

    def stop(self, route: str = "") -> None:
        """Stop by ``ros`` (the executor), ``mqtt`` (an account), ``control`` (the gateway alone) or ``halt``; "" for any."""
        route = route or self.chance.choice(("ros", "mqtt", "control", "halt"))
        if route in ("ros", "halt"):
            answer = self.client.call({"ros": "stop", "halt": "halt"}[route])
            assert answer.success, f"{route}: {answer.message}"
        elif route == "mqtt":
            answer = self.screen.press("stop", by="gateway")
            assert answer["ok"], f"stop/{ACCOUNT}: {answer['reason']}"
        else:
            self.screen.client.publish(self.topics.control, Control(uuid.uuid4().hex, "", "stop").to_json(), qos=1)
            self.client.wait(lambda: self.client.link.state == Link.NEEDS_RESET, "the gateway's stop", 5.0)
        self.stopped(f"stop by {route}", route != "ros")

    def stopped(self, route: str, at_gateway: bool = False) -> None:
        """Note that a stop, pause or rejection was answered with ok just now."""
        self._stops.append((route, time.monotonic(), at_gateway))

    def pause(self, route: str) -> None:
        """Pause by a route, and wait until the arm rests."""
        if route == "ros":
            answer = self.client.call("pause")
            assert answer.success, answer.message
        else:
            answer = self.screen.press("pause")
            assert answer["ok"], answer["reason"]
        self.stopped(f"pause by {route}")
        self.client.wait(lambda: self.client.execution.state == Execution.PAUSED, "PAUSED", 10.0)

    def resume(self, route: str) -> None:
        """Go on along the path."""
        asked = time.monotonic()
        if route == "ros":
            answer = self.client.call("resume")
            assert answer.success, answer.message
        else:
            asked = self._monotonic(self.screen.moment)
            answer = self.screen.press("resume")
            assert answer["ok"], answer["reason"]
        self.permissions.append(Permission(self.client.execution.plan_id, asked, resume=True))

    def reset(self) -> tuple[bool, str]:
        """Reset as a person does, whatever was stopped before."""
        self._undone.append(time.monotonic())
        answer = self.client.call("reset")
        return answer.success, answer.message

    def reject(self, plan, route: str) -> None:
        """Reject a plan."""
        if route == "ros":
            answer = self.client.review(plan.plan_id, plan.plan_hash, approve=False)
            assert answer.success, answer.message
        else:
            answer = self.screen.verdict(self.shown(plan), "rejected")
            assert answer["ok"], answer["reason"]
        self.stopped(f"rejection by {route}")

    def back(self) -> None:
        """Bring the robot to where a plan could be approved: reset what asks for it, end what is paused, wait for the rest."""
        deadline, asked, said = time.monotonic() + BACK, 0.0, ""
        while not (self.client.armed() and self.client.in_sync() and self.client.idle() and self.witness.arm.rests()):
            assert time.monotonic() < deadline, f"not back after {BACK:g} s: {self.client.describe()}; {said}"
            time.sleep(0.05)
            if time.monotonic() - asked < 2.0:
                continue
            with contextlib.suppress(*FAILURES):
                if self._needs_reset():
                    asked = time.monotonic()
                    said = f"the last reset: {self.reset()[1]}"
                elif self.client.execution and self.client.execution.state == Execution.PAUSED:
                    asked = time.monotonic()
                    said = f"stopped: {self.client.call('stop').message}"

    def _needs_reset(self) -> bool:
        link, sync = self.client.link, self.client.sync
        return (link and link.state == Link.NEEDS_RESET) or (sync and sync.state in (Sync.STOPPED, Sync.FAULT))

    # -- what a person is refused

    def refused(self, what: str, ask: Callable[[], tuple[bool, str]]) -> str:
        """Ask for what must be refused; note whether it was, and what on /diagnostics counted it. Return the answer's sentence."""
        before = self.counted()
        ok, sentence = ask()
        self.note_refusal(what, ok, sentence, before)
        return sentence

    def note_refusal(self, what: str, ok: bool, sentence: str, before: dict[str, int]) -> None:
        """Note whether something was refused, and which counter has risen since `counted` said `before`."""
        rose = ""
        deadline = time.monotonic() + 4.0
        while not rose and time.monotonic() < deadline:
            time.sleep(0.05)
            now = self.counted()
            rose = next((name for name, count in sorted(now.items()) if count > before.get(name, 0)), "")
        self.refusals.append(Refusal(f"{what} ({sentence})", not ok, rose))

    def counted(self) -> dict[str, int]:
        """Return what counts refusals, of every node and of the gateway."""
        found = {}
        for node in self.client.diagnosed_nodes():
            for key, value in self.client.diagnostics(node).items():
                if ("refused" in key or "not taken" in key) and value.isdecimal():
                    found[f"{node} {key}"] = int(value)
        return found

    # -- what the legs take

    def stops(self, until: float) -> tuple[Stop, ...]:
        """Return the stops since the last call; a stop at the gateway is undone by a reset, the executor's also by a verdict."""
        stops, self._stops = self._stops, []
        undone, self._undone = self._undone, []
        begun = [permission.moment for permission in self.permissions]
        found = []
        for route, answered, at_gateway in stops:
            later = [time_ for time_ in (undone if at_gateway else undone + begun) if time_ > answered]
            found.append(Stop(route, answered, min(later, default=until), at_gateway))
        return tuple(found)

    def forget(self) -> None:
        """Begin a new leg: the screen keeps its newest messages only."""
        self.permissions, self.refusals = [], []
        for heard in self.screen.heard.values():
            del heard[:-1]
        for changes in (self.client.plans, self.client.links, self.client.syncs):
            del changes[:-1]

    @staticmethod
    def _monotonic(moment: str) -> float:
        """Return a view's moment on the monotonic clock [s]."""
        asleep = time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()
        return (parse_moment(moment).at - asleep) / NANOSECONDS
