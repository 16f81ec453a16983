"""The access rules on the real mosquitto: every role, every topic, both directions. Roles and programs are written down again."""

from __future__ import annotations

import itertools
import socket

import pytest
from processes import ROOT, wait_until
from site_broker import ROBOTS, Listener, SiteBroker

from construction_twin.broker.access import MOVING, PLC, PROGRAMS, RIGHTS, ROLES, Grant, Person, Site, access_rules
from construction_twin.core.errors import ConfigurationError
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import REQUESTS

#: Account of a role at robot one.
ACCOUNTS = {
    "bridge": "one-bridge",
    "gateway": "one-gateway",
    "plc": "one-plc",
    "viewer": "one-viewer",
    "reviewer": "one-reviewer-ada",
    "stopper": "one-stopper-bob",
    "planner": "one-planner-ada",
    # a person with what no role has
    "lead": "dora",
}
#: What people write in the name of their account, by right; docs/reference/mqtt.md says it again, and is compared (test_docs.py).
OF_ACCOUNTS = [kind for kind in REQUESTS if "{}" in kind.topic]
ACTS = {kind.right: [each.topic[:-3] for each in OF_ACCOUNTS if each.right == kind.right] for kind in OF_ACCOUNTS}
ANSWERS = {kind.ack.format("one-planner-ada") for kind in OF_ACCOUNTS}
#: Who has which right.
HAVE = {
    "stop": ("reviewer", "stopper", "planner", "lead"),
    "pause": ("reviewer", "stopper"),
    "review": ("reviewer",),
    "plan_request": ("planner",),
    "trajectory": ("planner",),
    **dict.fromkeys(("reset", "arm", "answer", "acknowledge", "speed", "override_rehearsal"), ("lead",)),
}
PEOPLE = ("viewer", "reviewer", "stopper", "planner", "lead")
OF_PERSONS = ("reset", "arm", "answer", "acknowledge", "speed", "override_rehearsal")
OF_PEOPLE = {f"{act}/{ACCOUNTS[role]}" for acts in ACTS.values() for act in acts for role in PEOPLE}
TOPICS = (
    "command", "state", "status", "bridge/status", "control", "control/ack", "plan", "review", "scene",
    "screen", "work/tasks", "path", "messages", "rehearsal", "trajectory", "view", *sorted(ANSWERS), *sorted(OF_PEOPLE),
    "somewhere/else",
)  # fmt: skip
#: What each role publishes and what it hears, under <prefix>/<robot>/.
WRITES = {
    "bridge": {
        "command", "control", "bridge/status", "plan", "scene", "screen", "work/tasks", "path", "messages", "rehearsal",
        "view", *ANSWERS,
    },
    "gateway": {"state", "status", "control/ack", "stop/ack"},
    "plc": {"command", "control"},
} | {
    role: {f"{act}/{ACCOUNTS[role]}" for right, acts in ACTS.items() if role in HAVE[right] for act in acts} for role in PEOPLE
}  # fmt: skip
WRITES["planner"] |= {"trajectory"}
STOPS = {topic for topic in OF_PEOPLE if topic.startswith("stop/")}
READS = {
    # who takes `stop/+` also gets `stop/ack`
    "bridge": {"state", "status", "control/ack"}
    | {"plan", "scene", "work/tasks", "path", "messages", "rehearsal", "trajectory"}
    | OF_PEOPLE
    | ({f"{act}/ack" for acts in ACTS.values() for act in acts} & ANSWERS),
    "gateway": {"command", "control", "stop/ack"} | STOPS,
    "plc": {"state", "status", "control/ack"},
} | {role: set(TOPICS) for role in PEOPLE}  # fmt: skip
#: For every topic that anybody may write, one who may.
WRITER = {topic: role for role in WRITES for topic in WRITES[role]}
NOT_AUTHORIZED = 135
BY_NAME = {"reviewers": ("ada", "ben"), "stoppers": ("bob",)}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    cora = Person("cora", (Grant(("review",), ("one",)), Grant(("view",), ("two",))))
    dora = Person("dora", (Grant(OF_PERSONS, ("one",)),))
    site = SiteBroker(tmp_path_factory.mktemp("site"), planners=("ada", "ben"), persons=(cora, dora), **BY_NAME)
    site.start()
    yield site
    site.stop()


@pytest.fixture(scope="module", params=["account", "certificate"])
def crowd(site, request):
    """One listener per role at robot one, subscribed to everything there is."""
    listeners = {
        role: Listener(site.broker(site.account(ACCOUNTS[role], request.param)), "#", f"{request.param}-{role}")
        for role in WRITES
    }
    yield listeners
    for listener in listeners.values():
        listener.close()


def payloads(prefix: str):
    return (f"{prefix} {number}".encode() for number in itertools.count())


NUMBERS = payloads("message")
#: Where the end of a test is marked.
MARKED = "twin/one/review/one-reviewer-ada"


def test_the_table_knows_every_role_and_topic():
    assert set(WRITES) == set(READS) == set(ACCOUNTS) == {*PROGRAMS, *ROLES, PLC, "lead"}
    topics = Topics("twin", "one")
    names = [name for name, value in vars(Topics).items() if isinstance(value, property)]
    listed = {getattr(topics, name) for name in names}
    for kind in OF_ACCOUNTS:
        listed |= {topics.of(kind, ACCOUNTS[role]) for role in PEOPLE} | {topics.ack_of(kind, "one-planner-ada")}
    assert listed == {f"twin/one/{topic}" for topic in TOPICS[:-1]}


def test_every_right_is_in_a_role_and_has_its_rules():
    assert {right for rights in ROLES.values() for right in rights} | {*OF_PERSONS} == set(RIGHTS) == {"view", *ACTS}
    assert not {*OF_PERSONS} & {right for rights in ROLES.values() for right in rights}, "nobody has these unless named"
    assert {path.stem for path in (ROOT / "config/mosquitto").glob("right_*.acl")} == {
        f"right_{right}" for right in RIGHTS
    }
    assert all("stop" in rights for rights in ROLES.values() if set(MOVING) & set(rights)), (
        "who may move it may stop it"
    )
    assert {role for role in ROLES if "review" in ROLES[role]} == set(HAVE["review"])


@pytest.mark.parametrize("role", sorted(WRITES))
def test_a_role_publishes_what_it_may_and_nothing_else(crowd, role):
    """Every act: QoS 1, so that a refused one is answered with 135, and nobody hears it."""
    sent = {topic: next(NUMBERS) for topic in TOPICS}
    answers = crowd[role].publish_all({f"twin/one/{topic}": payload for topic, payload in sent.items()})
    assert set(answers) <= {0, 16, NOT_AUTHORIZED}
    assert {topic for topic, answer in zip(TOPICS, answers) if answer != NOT_AUTHORIZED} == WRITES[role]
    # whoever hears everything has heard it, or hears only the next permitted one
    marker = next(NUMBERS)
    assert crowd["reviewer"].publish(MARKED, marker).value != NOT_AUTHORIZED
    viewer = crowd["viewer"]
    wait_until(lambda: (MARKED, marker) in viewer.messages, what="the marker")
    assert {topic for topic in TOPICS if (f"twin/one/{topic}", sent[topic]) in viewer.messages} == WRITES[role]


@pytest.mark.parametrize("role", sorted(READS))
def test_a_role_hears_what_it_may_and_nothing_else(crowd, role):
    sent = {topic: next(NUMBERS) for topic in WRITER}
    # what it may hear comes last, so that what it may not hear would have come before
    for may in (False, True):
        for writer in WRITES:
            topics = [topic for topic in WRITER if WRITER[topic] == writer and (topic in READS[role]) is may]
            crowd[writer].publish_all({f"twin/one/{topic}": sent[topic] for topic in topics})
    due = {(f"twin/one/{topic}", sent[topic]) for topic in WRITER if topic in READS[role]}
    listener = crowd[role]
    wait_until(lambda: due <= set(listener.messages), what=f"what {role} may hear")
    heard = {topic for topic, payload in listener.messages if payload in sent.values()}
    assert heard == {topic for topic, _ in due}


@pytest.mark.parametrize("role", sorted(WRITES))
def test_a_role_at_one_robot_can_do_nothing_at_the_other(site, crowd, role):
    other = Listener(site.broker(site.account("two-viewer")), "#", "other")
    reviewer = Listener(site.broker(site.account("two-reviewer-ben")), "#", "other reviewer")
    try:
        elsewhere = {f"twin/two/{topic}".replace("one-", "two-"): b"foreign" for topic in TOPICS}
        elsewhere |= {f"twin/two/{topic}": b"foreign" for topic in OF_PEOPLE}
        assert set(crowd[role].publish_all(elsewhere)) == {NOT_AUTHORIZED}
        marker = next(NUMBERS)
        reviewer.publish("twin/two/review/two-reviewer-ben", marker)
        wait_until(lambda: ("twin/two/review/two-reviewer-ben", marker) in other.messages, what="the marker")
        assert [message for message in other.messages if message[1] == b"foreign"] == []
        mine = next(NUMBERS)
        crowd["bridge"].publish("twin/one/plan", mine)
        crowd["gateway"].publish("twin/one/status", mine)
        crowd["bridge"].publish("twin/one/command", mine)
        wait_until(lambda: any(payload == mine for _, payload in crowd[role].messages), what="one of the own robot's")
        assert not any(topic.startswith("twin/two/") for topic, _ in crowd[role].messages)
    finally:
        other.close()
        reviewer.close()


@pytest.mark.parametrize("topic", ["$SYS/broker/version", "twin/one", "twin", "other/one/command", "twin/+/command"])
def test_nobody_publishes_outside_the_robots_topics(crowd, topic):
    for role in WRITES:
        if "+" in topic:
            with pytest.raises(ValueError, match="wildcards"):
                crowd[role].client.publish(topic, b"x", qos=1)
        else:
            assert crowd[role].publish(topic, b"x").value == NOT_AUTHORIZED, role


@pytest.mark.parametrize("act", ["review", "stop", "pause", "resume", "plan_request", "ik"])
def test_nobody_acts_in_another_one_s_name(site, crowd, act):
    """The name on record is the topic's, so nobody else may write there: not even who may do the same in a name of his own."""
    role = "planner" if act in ("plan_request", "ik") else "reviewer"
    ben = Listener(site.broker(site.account(f"one-{role}-ben")), "#", "ben")
    try:
        forged = {f"twin/one/{act}/{name}": b"not me" for name in (f"one-{role}-ada", "one-bridge", "ben", "ack/x")}
        assert set(ben.publish_all(forged)) == {NOT_AUTHORIZED}
        mine = next(NUMBERS)
        assert ben.publish(f"twin/one/{act}/one-{role}-ben", mine).value != NOT_AUTHORIZED
        bridge = crowd["bridge"]
        wait_until(lambda: (f"twin/one/{act}/one-{role}-ben", mine) in bridge.messages, what="what Ben sent")
        assert not any(payload == b"not me" for _, payload in bridge.messages)
    finally:
        ben.close()


def test_a_planner_cannot_send_in_another_one_s_name(site, crowd):
    ben = Listener(site.broker(site.account("one-planner-ben")), "#", "ben")
    try:
        assert ben.publish("twin/one/trajectory/from/one-planner-ada", b"not Ada").value == NOT_AUTHORIZED
        mine = next(NUMBERS)
        assert ben.publish("twin/one/trajectory/from/one-planner-ben", mine).value != NOT_AUTHORIZED
        bridge = crowd["bridge"]
        wait_until(lambda: ("twin/one/trajectory/from/one-planner-ben", mine) in bridge.messages, what="what Ben sent")
        assert not any(payload == b"not Ada" for _, payload in bridge.messages)
    finally:
        ben.close()


def test_a_person_does_at_each_robot_what_was_granted_there_in_the_person_s_own_name(site, crowd):
    cora = Listener(site.broker(site.account("cora")), "twin/+/view", "cora")
    other = Listener(site.broker(site.account("two-bridge")), "#", "two")
    try:
        mine = next(NUMBERS)
        for act in ("review", "stop"):
            assert cora.publish(f"twin/one/{act}/cora", mine).value != NOT_AUTHORIZED
            wait_until(lambda act=act: (f"twin/one/{act}/cora", mine) in crowd["bridge"].messages, what=act)
        refused = [f"twin/two/{act}/cora" for act in ("review", "stop", "pause")]
        refused += ["twin/one/review/one-reviewer-ada", "twin/one/plan_request/cora", "twin/one/control"]
        assert {cora.publish(topic, b"no").value for topic in refused} == {NOT_AUTHORIZED}
        # both robots in one picture
        for robot, bridge in (("one", crowd["bridge"]), ("two", other)):
            bridge.publish(f"twin/{robot}/view", mine)
            wait_until(lambda robot=robot: (f"twin/{robot}/view", mine) in cora.messages, what=f"the view of {robot}")
    finally:
        cora.close()
        other.close()


def test_a_long_trajectory_passes_the_broker_and_a_still_longer_one_does_not(site, crowd):
    """At 16 kB to 64 kB most of compas_fab's would be cut off."""
    bridge, long = crowd["bridge"], b"x" * 3_000_000
    crowd["planner"].publish("twin/one/trajectory", long)
    wait_until(lambda: ("twin/one/trajectory", long) in bridge.messages, what="3 MB")
    ben = Listener(site.broker(site.account("one-planner-ben")), "twin/one/view", "ben")
    try:
        gone = []
        ben.client.on_disconnect = lambda *_: gone.append(True)
        ben.client.publish("twin/one/trajectory", b"x" * 5_000_000, qos=0)
        wait_until(lambda: gone, what="the broker's hanging up")
    finally:
        ben.close()
    assert not any(len(payload) == 5_000_000 for _, payload in bridge.messages)


def test_nobody_hears_the_broker_s_own_figures(site):
    listener = Listener(site.broker(site.account("one-viewer")), "$SYS/#", "curious")
    bridge = Listener(site.broker(site.account("one-bridge")), "twin/one/plan", "bridge")
    try:
        listener.client.subscribe("twin/one/plan", 1)
        wait_until(lambda: bridge.publish("twin/one/plan", b"shown") and listener.messages, what="the plan")
        assert {topic for topic, _ in listener.messages} == {"twin/one/plan"}
    finally:
        listener.close()
        bridge.close()


def leave_a_will(site, topic: str, payload: bytes) -> None:
    """Connect as a reviewer with a last will, and lose the connection."""
    cut = Listener(site.broker(site.account("one-reviewer-ada")), "twin/one/plan", "cut")
    cut.client.loop_stop()
    cut.client.disconnect()
    cut.client.will_set(topic, payload, qos=1)
    cut.client.reconnect()
    cut.client.loop_start()
    wait_until(cut.client.is_connected, what="the connection with a will")
    cut.client.loop_stop()
    cut.client.socket().shutdown(socket.SHUT_RDWR)


def test_a_last_will_obeys_the_rules_too(site, crowd):
    viewer, allowed = crowd["viewer"], next(NUMBERS)
    leave_a_will(site, "twin/one/command", b"from the grave")
    leave_a_will(site, MARKED, allowed)
    # the broker carries out wills in the order in which connections end
    wait_until(lambda: (MARKED, allowed) in viewer.messages, what="the will that is allowed")
    assert not any(payload == b"from the grave" for _, payload in viewer.messages)


# -- the rules as text


def template(name: str) -> str:
    return (ROOT / "config/mosquitto" / name).read_text()


def site_of(**changes) -> Site:
    return Site(**({"hosts": ("broker",), "robots": ROBOTS, "folder": "/etc/mosquitto/site"} | changes))


def test_every_account_has_rules_and_none_may_command_without_being_asked_for():
    rules = access_rules(site_of(reviewers=("anna", "ben")), template)
    users = [line.removeprefix("user ") for line in rules.splitlines() if line.startswith("user ")]
    assert users == [
        f"{robot}-{who}" for robot in ROBOTS for who in ("bridge", "gateway", "viewer", "reviewer-anna", "reviewer-ben")
    ]
    commanders = [part for part in rules.split("user ") if "write twin/one/command" in part]
    assert [part.split("\n")[0] for part in commanders] == ["one-bridge"]


def test_a_prefix_of_ones_own_stands_in_every_rule():
    rules = access_rules(site_of(prefix="hall7", robots=("kr120",)), template)
    topics = [line.split()[2] for line in rules.splitlines() if line.startswith("topic")]
    assert len(topics) > 10 and all(topic.startswith("hall7/kr120/") for topic in topics)


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"robots": ("a b",)}, "--robot"),
        ({"robots": ("a\nuser x",)}, "--robot"),
        ({"robots": ("#",)}, "--robot"),
        ({"robots": ()}, "--robot"),
        ({"hosts": ()}, "--host"),
        ({"hosts": ("a,DNS:evil",)}, "--host"),
        ({"hosts": ("-x",)}, "--host"),
        ({"reviewers": ("anna:x",)}, "--reviewer"),
        ({"reviewers": ("+",)}, "--reviewer"),
        ({"stoppers": ("a/b",)}, "--stopper"),
        ({"viewers": ("a b",)}, "--viewer"),
        ({"consoles": ("a b",)}, "--console"),
        ({"console_port": 0}, "--console-port"),
        ({"planners": ("ada/#",)}, "--planner"),
        ({"prefix": "a/b"}, "--prefix"),
        ({"port": 65535}, "--port"),
        ({"folder": "/a b"}, "--broker-folder"),
        ({"robots": ("a", "a-reviewer"), "reviewers": ("reviewer-x", "x")}, "--robot and the names of people"),
    ],
)
def test_a_name_that_could_change_the_rules_is_refused(changes, said):
    with pytest.raises(ConfigurationError, match=said):
        site_of(**changes)


@pytest.mark.parametrize("text", ["user $account\ntopic read $nothing", "user $", "topic write ${topics"])
def test_a_template_with_other_names_is_one_sentence(text):
    with pytest.raises(ConfigurationError, match="template bridge.acl"):
        access_rules(site_of(), lambda name: text)
