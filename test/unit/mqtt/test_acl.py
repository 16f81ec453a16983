"""The access rules on the real mosquitto: every account, every topic, both directions. What each may do is written down again."""

from __future__ import annotations

import itertools
import socket

import pytest
from processes import ROOT, wait_until
from site_broker import ROBOTS, Listener, SiteBroker

from construction_twin.broker.access import PLC, PROGRAMS, RIGHTS, Site, access_rules
from construction_twin.core.errors import ConfigurationError
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import NAMELESS_REVIEW, NAMELESS_TRAJECTORY, REQUESTS

#: What people write in the name of their account, by right: `mqtt.requests` and docs/reference/mqtt.md once more.
ACTS = {
    "look": set(),
    "operate": {"stop", "pause", "answer", "acknowledge", "lower_speed", "plan_request", "trajectory/from"},
    "approve": {"stop", "review", "override_rehearsal", "resume", "raise_speed"},
    "reset": {"stop", "reset", "arm"},
}
#: A person with each right alone at robot one, and one with all of them.
PEOPLE = {"vic": ("look",), "olaf": ("operate",), "ann": ("approve",), "rita": ("reset",), "dora": RIGHTS}
PERSONS = (
    *(
        "vic:look@one",
        "olaf:operate@one",
        "ann:approve@one",
        "rita:reset@one",
        "dora:operate,approve@one",
        "dora:reset@one",
    ),
    *("ben:operate,approve,reset@two", "cora:approve@one", "cora:look@two"),
)
OF_ACCOUNTS = [kind for kind in REQUESTS if "{}" in kind.topic]
ANSWERS = {kind.ack.format("olaf") for kind in OF_ACCOUNTS}
OF_PEOPLE = {f"{act}/{name}" for acts in ACTS.values() for act in acts for name in PEOPLE}
TOPICS = (
    "command", "state", "status", "bridge/status", "control", "control/ack", "plan", "review", "scene",
    "screen", "work/tasks", "path", "messages", "rehearsal", "trajectory", "view", *sorted(ANSWERS), *sorted(OF_PEOPLE),
)  # fmt: skip
#: What nobody may write, in a name that is none or somebody else's.
FORGED = ("somewhere/else", "review/ben", "review/one-bridge", "review/ack/x", "stop/ack/x", "stop", "resume/vic/x")
#: What each account publishes and what it hears, under <prefix>/<robot>/.
WRITES = {
    "one-bridge": {
        "command", "control", "bridge/status", "plan", "scene", "screen", "work/tasks", "path", "messages", "rehearsal",
        "view", *ANSWERS,
    },
    "one-gateway": {"state", "status", "control/ack", "stop/ack"},
    "one-plc": {"command", "control"},
} | {
    name: {f"{act}/{name}" for right in rights for act in ACTS[right]} | ({"trajectory"} if "operate" in rights else set())
    for name, rights in PEOPLE.items()
}  # fmt: skip
STOPS = {topic for topic in OF_PEOPLE if topic.startswith("stop/")}
READS = {
    # who takes `stop/+` also gets `stop/ack`
    "one-bridge": {"state", "status", "control/ack"}
    | {"plan", "scene", "work/tasks", "path", "messages", "rehearsal", "trajectory"}
    | OF_PEOPLE
    | ({f"{act}/ack" for acts in ACTS.values() for act in acts} & ANSWERS),
    "one-gateway": {"command", "control", "stop/ack"} | STOPS,
    "one-plc": {"state", "status", "control/ack"},
} | {name: set(TOPICS) for name in PEOPLE}  # fmt: skip
#: For every topic that anybody may write, one who may.
WRITER = {topic: account for account in WRITES for topic in WRITES[account]}
NOT_AUTHORIZED = 135


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    site = SiteBroker(tmp_path_factory.mktemp("site"), persons=PERSONS)
    site.start()
    yield site
    site.stop()


@pytest.fixture(scope="module")
def crowd(site):
    """One listener per account at robot one, subscribed to everything there is."""
    listeners = {name: Listener(site.broker(site.account(name)), "#", name) for name in WRITES}
    yield listeners
    for listener in listeners.values():
        listener.close()


def payloads(prefix: str):
    return (f"{prefix} {number}".encode() for number in itertools.count())


NUMBERS = payloads("message")
#: Where the end of a test is marked.
MARKED = "twin/one/review/ann"


def test_the_table_knows_every_account_right_and_topic():
    programs = {f"one-{program}" for program in (*PROGRAMS, PLC)}
    assert set(WRITES) == set(READS) == programs | set(PEOPLE)
    assert tuple(ACTS) == RIGHTS
    topics = Topics("twin", "one")
    names = [name for name, value in vars(Topics).items() if isinstance(value, property)]
    listed = {getattr(topics, name) for name in names}
    listed |= {topics.of(NAMELESS_REVIEW), topics.of(NAMELESS_TRAJECTORY)}
    for kind in OF_ACCOUNTS:
        listed |= {topics.of(kind, name) for name in PEOPLE} | {topics.ack_of(kind)}
    assert listed == {f"twin/one/{topic}" for topic in TOPICS}


@pytest.mark.parametrize("account", sorted(WRITES))
def test_an_account_publishes_what_it_may_and_nothing_else(crowd, account):
    """Every act, also in each other one's name: QoS 1, so that a refused one is answered with 135, and nobody hears it."""
    sent = {topic: next(NUMBERS) for topic in (*TOPICS, *FORGED)}
    answers = crowd[account].publish_all({f"twin/one/{topic}": payload for topic, payload in sent.items()})
    assert set(answers) <= {0, 16, NOT_AUTHORIZED}
    assert {topic for topic, answer in zip(sent, answers) if answer != NOT_AUTHORIZED} == WRITES[account]
    # whoever hears everything has heard it, or hears only the next permitted one
    marker = next(NUMBERS)
    assert crowd["ann"].publish(MARKED, marker).value != NOT_AUTHORIZED
    viewer = crowd["vic"]
    wait_until(lambda: (MARKED, marker) in viewer.messages, what="the marker")
    assert {topic for topic in sent if (f"twin/one/{topic}", sent[topic]) in viewer.messages} == WRITES[account]


@pytest.mark.parametrize("account", sorted(READS))
def test_an_account_hears_what_it_may_and_nothing_else(crowd, account):
    sent = {topic: next(NUMBERS) for topic in WRITER}
    # what it may hear comes last, so that what it may not hear would have come before
    for may in (False, True):
        for writer in WRITES:
            topics = [topic for topic in WRITER if WRITER[topic] == writer and (topic in READS[account]) is may]
            crowd[writer].publish_all({f"twin/one/{topic}": sent[topic] for topic in topics})
    due = {(f"twin/one/{topic}", sent[topic]) for topic in WRITER if topic in READS[account]}
    listener = crowd[account]
    wait_until(lambda: due <= set(listener.messages), what=f"what {account} may hear")
    heard = {topic for topic, payload in listener.messages if payload in sent.values()}
    assert heard == {topic for topic, _ in due}


@pytest.mark.parametrize("account", sorted(WRITES))
def test_an_account_at_one_robot_can_do_nothing_at_the_other(site, crowd, account):
    other = Listener(site.broker(site.account("ben")), "#", "other")
    try:
        elsewhere = {f"twin/two/{topic}".replace("one-", "two-"): b"foreign" for topic in TOPICS}
        elsewhere |= {f"twin/two/{act}/ben": b"foreign" for acts in ACTS.values() for act in acts}
        assert set(crowd[account].publish_all(elsewhere)) == {NOT_AUTHORIZED}
        marker = next(NUMBERS)
        other.publish("twin/two/review/ben", marker)
        wait_until(lambda: ("twin/two/review/ben", marker) in other.messages, what="the marker")
        assert [message for message in other.messages if message[1] == b"foreign"] == []
        mine = next(NUMBERS)
        crowd["one-bridge"].publish("twin/one/plan", mine)
        crowd["one-gateway"].publish("twin/one/status", mine)
        crowd["one-bridge"].publish("twin/one/command", mine)
        wait_until(
            lambda: any(payload == mine for _, payload in crowd[account].messages), what="one of the own robot's"
        )
        assert not any(topic.startswith("twin/two/") for topic, _ in crowd[account].messages)
    finally:
        other.close()


@pytest.mark.parametrize("topic", ["$SYS/broker/version", "twin/one", "twin", "other/one/command", "twin/+/command"])
def test_nobody_publishes_outside_the_robots_topics(crowd, topic):
    for account in WRITES:
        if "+" in topic:
            with pytest.raises(ValueError, match="wildcards"):
                crowd[account].client.publish(topic, b"x", qos=1)
        else:
            assert crowd[account].publish(topic, b"x").value == NOT_AUTHORIZED, account


def test_a_person_does_at_each_robot_what_was_granted_there_in_the_person_s_own_name(site, crowd):
    cora = Listener(site.broker(site.account("cora")), "twin/+/view", "cora")
    other = Listener(site.broker(site.account("two-bridge")), "#", "two")
    try:
        mine = next(NUMBERS)
        for act in ("review", "stop"):
            assert cora.publish(f"twin/one/{act}/cora", mine).value != NOT_AUTHORIZED
            wait_until(lambda act=act: (f"twin/one/{act}/cora", mine) in crowd["one-bridge"].messages, what=act)
        refused = [f"twin/two/{act}/cora" for act in ("review", "stop", "pause")]
        refused += ["twin/one/review/ann", "twin/one/plan_request/cora", "twin/one/control"]
        assert {cora.publish(topic, b"no").value for topic in refused} == {NOT_AUTHORIZED}
        # both robots in one picture
        for robot, bridge in (("one", crowd["one-bridge"]), ("two", other)):
            bridge.publish(f"twin/{robot}/view", mine)
            wait_until(lambda robot=robot: (f"twin/{robot}/view", mine) in cora.messages, what=f"the view of {robot}")
    finally:
        cora.close()
        other.close()


def test_a_long_trajectory_passes_the_broker_and_a_still_longer_one_does_not(site, crowd):
    bridge, long = crowd["one-bridge"], b"x" * 3_000_000
    crowd["olaf"].publish("twin/one/trajectory", long)
    wait_until(lambda: ("twin/one/trajectory", long) in bridge.messages, what="3 MB")
    ben = Listener(site.broker(site.account("olaf")), "twin/one/view", "ben")
    try:
        gone = []
        ben.client.on_disconnect = lambda *_: gone.append(True)
        ben.client.publish("twin/one/trajectory", b"x" * 5_000_000, qos=0)
        wait_until(lambda: gone, what="the broker's hanging up")
    finally:
        ben.close()
    assert not any(len(payload) == 5_000_000 for _, payload in bridge.messages)


def test_nobody_hears_the_broker_s_own_figures(site):
    listener = Listener(site.broker(site.account("vic")), "$SYS/#", "curious")
    bridge = Listener(site.broker(site.account("one-bridge")), "twin/one/plan", "bridge")
    try:
        listener.client.subscribe("twin/one/plan", 1)
        wait_until(lambda: bridge.publish("twin/one/plan", b"shown") and listener.messages, what="the plan")
        assert {topic for topic, _ in listener.messages} == {"twin/one/plan"}
    finally:
        listener.close()
        bridge.close()


def leave_a_will(site, topic: str, payload: bytes) -> None:
    """Connect as a person with a last will, and lose the connection."""
    cut = Listener(site.broker(site.account("ann")), "twin/one/plan", "cut")
    cut.client.loop_stop()
    cut.client.disconnect()
    cut.client.will_set(topic, payload, qos=1)
    cut.client.reconnect()
    cut.client.loop_start()
    wait_until(cut.client.is_connected, what="the connection with a will")
    cut.client.loop_stop()
    cut.client.socket().shutdown(socket.SHUT_RDWR)


def test_a_last_will_obeys_the_rules_too(site, crowd):
    viewer, allowed = crowd["vic"], next(NUMBERS)
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
        *(
            ({"persons": (words,)}, "--person")
            for words in (
                "ada",
                "ada:",
                "ada:approve@",
                "ada:approve:x",
                "ada:root",
                "ada:stop",
                "ada:approve@three",
                "+:look",
                "a/b:look",
                "ada/#:look",
                "a b:look",
                "bridge:look",
                "console:look",
                "ack:approve",
                "one-gateway:look",
                "two-x:look",
            )
        ),
        ({"consoles": ("a b",)}, "--console"),
        ({"prefix": "a/b"}, "--prefix"),
        ({"port": 65536}, "--port"),
        ({"folder": "/a b"}, "--broker-folder"),
    ],
)
def test_a_name_that_could_change_the_rules_is_refused(changes, said):
    with pytest.raises(ConfigurationError, match=said):
        site_of(**changes)
