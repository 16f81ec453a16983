"""The link benchmark in its smallest form, with real processes: its files have the promised shape, and what it counts adds up."""

from __future__ import annotations

import importlib
import json
import signal
import subprocess
import sys
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt._packet import decode_publish
from paho.mqtt.enums import MQTTProtocolVersion
from processes import ROOT

FOLDER = ROOT / "benchmarks"
FIGURES = {"p50_ms", "p99_ms", "p99_9_ms", "max_ms", "lost", "sent", "cpu_s_per_1000"}
ROUTES = ("ros_to_mqtt", "mqtt_to_ros", "round_trip", "duplex")
#: Normal scheduling: a test must not take the processors from the tests beside it.
SHORT = ["--rounds", "1", "--seconds", "1", "--rate-seconds", "0.2", "--reply-seconds", "1", "--fleet", "1",
         "--fleet-seconds", "1", "--realtime", "0"]  # fmt: skip


@pytest.fixture(scope="module")
def modules():
    """Import a module of the benchmarks' folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        yield importlib.import_module


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The benchmark's two files after a short run."""
    path = tmp_path_factory.mktemp("bench") / "new" / "link.json"
    command = [sys.executable, FOLDER / "link.py", *SHORT, "--output", path]
    run = subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stdout + run.stderr
    return json.loads(path.read_text()), json.loads(path.with_name("link_details.json").read_text()), run.stdout


def test_routes_have_the_promised_figures(files):
    for route in ROUTES:
        assert set(files[0][route]) == {"ours", "floor"}
        for figures in files[0][route].values():
            assert set(figures) == FIGURES
            assert figures["sent"] == (500 if route == "duplex" else 250)
            assert 0 <= figures["lost"] < figures["sent"]
            assert 0.0 < figures["p50_ms"] <= figures["p99_ms"] <= figures["p99_9_ms"] <= figures["max_ms"]
            assert figures["cpu_s_per_1000"] > 0.0
    assert files[1]["bare_sockets"]["hops"] == 6
    assert 0.0 < files[1]["bare_sockets"]["p50_ms"] <= files[1]["bare_sockets"]["max_ms"]
    assert set(files[0]["max_rate_hz"]) == set(files[1]["max_rate_hz_floor"]) == {"ros_to_mqtt", "mqtt_to_ros"}


def test_reply_time_has_the_promised_figures(files):
    assert set(files[0]["reply_us"]) == {"idle", "loaded"}
    for figures in files[0]["reply_us"].values():
        assert set(figures) == {"p50", "p99", "p99_9", "max", "late", "cycles"}
        assert figures["cycles"] >= 100 and figures["late"] >= 0
        assert figures["p50"] <= figures["p99"]


def test_fleet_and_smoothness_have_the_promised_figures(files):
    (row,) = files[0]["fleet"]
    assert set(row) == {"robots", "cpu_per_robot", "p99_ms", "late"}
    assert row["robots"] == 1 and row["cpu_per_robot"] > 0.0 and row["p99_ms"] > 0.0
    for figures in files[0]["smoothness"].values():
        assert set(figures) == {"ours", "naive"}
        assert all(set(one) == {"acc_ratio", "jerk_ratio"} for one in figures.values())


def test_end_to_end_shows_the_playout_delay_apart(files):
    parts = files[1]["end_to_end"]
    assert parts["playout"]["delay_ms"] >= 16.0
    # the playout holds a command back for most of its delay; without it a command would take a few ms
    assert parts["command_to_rsi_packet"]["p50_ms"] >= 8.0
    assert parts["rsi_reply_to_ros"]["p50_ms"] > 0.0 and parts["command_to_broker"]["p50_ms"] > 0.0


def test_file_has_these_keys_and_no_others(files):
    assert set(files[0]) == {*ROUTES, "max_rate_hz", "reply_us", "smoothness", "fleet", "environment"}
    assert {"cpu", "cores", "load", "load_after", "scheduling"} <= set(files[0]["environment"])
    for route in ROUTES:
        assert route in files[2]


def test_what_did_not_arrive_is_lost_and_what_came_twice_is_not(modules):
    heard = modules("link_peer").Heard
    sender = heard(sent=[100, 200, 300])
    outcome = modules("link_routes").outcome([(sender, [(100, 150), (300, 420), (300, 999), (7, 8)])], 0.1)
    assert (outcome.latencies, outcome.sent, outcome.lost) == ([50, 120], 3, 1)


def test_rounds_are_pooled_not_averaged(modules):
    one = {"latencies": [1_000_000] * 99, "sent": 100, "lost": 1, "cpu_s_per_1000": 0.1}
    other = {"latencies": [9_000_000], "sent": 1, "lost": 0, "cpu_s_per_1000": 0.3}
    figures = modules("link").pooled([one, other])
    assert (figures["p50_ms"], figures["max_ms"], figures["sent"], figures["lost"]) == (1.0, 9.0, 101, 1)
    assert figures["cpu_s_per_1000"] == 0.2


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([(1, 1.0, 0), (2, 1.9, 0)], None),
        ([(1, 1.0, 0), (2, 1.9, 0), (4, 2.1, 0), (8, 30.0, 9)], 4),
        ([(1, 1.0, 5), (2, 1.0, 10), (4, 1.0, 30)], 4),
        ([(1, 1.0, 0), (2, None, None)], 2),
    ],
)
def test_knee_is_where_latency_doubles_or_replies_are_late(modules, rows, expected):
    rows = [dict(zip(("robots", "p99_ms", "late"), row)) for row in rows]
    # 5000 cycles per robot
    assert modules("link").knee(rows, 20.0) == expected


def test_command_to_rsi_uses_the_reply_that_carried_the_target(modules):
    states = [("r", 1, 1000, 0), ("r", 2, 5000, 900), ("r", 4, 13_000, 8800), ("r", 5, 17_000, 12_800)]
    # seq 3 is missing: the time of its reply is not known
    assert modules("link_fleet").command_to_rsi(states) == [100, 200]


TEXT = st.text(max_size=30).filter(lambda text: not set(text) & {"\0", "\ufeff"})


@given(TEXT, st.binary(max_size=300), st.lists(st.tuples(TEXT, TEXT), max_size=4))
def test_lean_client_speaks_mqtt(modules, topic, payload, pairs):
    mqtt = modules("link_mqtt")
    packet = mqtt.publish_packet(topic, payload, pairs)
    length, at = mqtt.read_varint(packet, 1)
    body = packet[at:]
    assert length == len(body)
    known = decode_publish(packet[0], body, MQTTProtocolVersion.MQTTv5)
    assert (known.topic.decode(), bytes(known.payload)) == (topic, payload)
    assert list(getattr(known.properties, "UserProperty", ())) == pairs
    assert mqtt.read_publish(body) == (topic, payload, pairs)


@pytest.fixture
def soak(modules, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    return importlib.import_module("soak")


def minute(soak, memory=(60.0, 40.0, 50.0), late=0, lost=0, distance=-4.0, holds=0):
    return soak.Minute(memory, late, lost, distance, holds)


def test_soak_that_only_warms_up_is_good(soak):
    minutes = [minute(soak, (50.0, 30.0, 40.0), distance=9.0)] + [minute(soak)] * 8
    assert soak.verdict(minutes) == []


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"late": 1}, "late"),
        ({"lost": 1}, "lost"),
        ({"holds": 1}, "held 4 times"),
        ({"memory": (60.0, 43.0, 50.0)}, "gateway grew"),
        ({"distance": 4.0}, "beyond the playout"),
    ],
)
def test_soak_names_what_is_wrong(soak, changes, word):
    minutes = [minute(soak)] * 5 + [minute(soak, **changes)] * 4
    (sentence,) = soak.verdict(minutes)
    assert word in sentence


@pytest.mark.parametrize(
    "distances, pauses, expected",
    [
        ((4, 4, 4), [], (0, 0)),
        ((4, 5.9, 4), [], (0, 0)),
        ((4, 8, 4), [], (1, 1)),
        ((4, 8, 4), [(0.0, 4.0)], (1, 1)),
        ((4, 8, 4), [(5.0, 6.5)], (1, 1)),
        ((4, 8, 4), [(5.0, 7.0)], (1, 0)),
        ((4, 8, 4), [(3.0, 6.1)], (1, 0)),
        ((4, 8, 4), [(11.0, 30.0)], (1, 1)),
        # two cores that stand at the same time are not twice as long
        ((4, 8, 4), [(5.0, 6.5), (5.1, 6.5)], (1, 1)),
        ((4, 8, 4), [(5.0, 6.5), (7.0, 7.6)], (1, 0)),
        ((8, 4, 9), [(1.0, 3.0), (12.5, 16.0)], (2, 0)),
        ((8, 4, 9), [(1.0, 3.0)], (2, 1)),
    ],
)
def test_replies_held_up_beside_no_pause_are_ours(modules, distances, pauses, expected):
    base = 10**15
    stamps = [base]
    for distance in distances:
        stamps.append(stamps[-1] + round(distance * 1e6))
    intervals = [(base + round(begin * 1e6), base + round(end * 1e6)) for begin, end in pauses]
    assert modules("machine").held_up(stamps, intervals) == expected


def test_replies_are_compared_within_stretches_only(modules):
    replies, quiet = modules("machine").Replies(), {"intervals": [], "above": True}
    cycle = 4_000_000
    assert [replies.add(k, k * cycle) for k in (1, 2, 3)] == [0, 0, 0]
    # two states lost: what the gateway did there is not known
    assert replies.add(6, 6 * cycle) == 2
    assert replies.taken(quiet) == (0, 0)
    # the next one is compared with the last one before
    assert replies.add(7, 8 * cycle) == 0
    assert replies.taken(quiet) == (1, 1)
    assert replies.taken(quiet) == (0, 0)
    replies.interrupt()
    assert replies.add(500, 600 * cycle) == 0
    replies.add(501, 603 * cycle)
    # a probe that sees what we do cannot tell whose pause it was
    assert replies.taken({"intervals": [(600 * cycle, 603 * cycle)], "above": False}) == (1, None)


def test_soak_does_not_claim_to_know_what_it_does_not(soak):
    minutes = [soak.Minute((60.0, 40.0, 50.0), 3, 0, -4.0, held_up=3, held_up_by_us=by_us) for by_us in (1, None)]
    assert "of 6 replies held up an unknown number beside no pause" in soak.verdict(minutes)[0]
    assert "of 3 replies held up 1 beside" in soak.verdict(minutes[:1])[0]


def test_the_probe_tells_when_a_watch_did_not_run(modules):
    machine = modules("machine")
    with machine.MachineProbe(0) as probe:
        probe.taken()
        before = time.monotonic_ns()
        watch = probe.watches[-1]
        watch.send_signal(signal.SIGSTOP)
        time.sleep(0.05)
        watch.send_signal(signal.SIGCONT)
        seen = probe.taken()
        after = time.monotonic_ns()
    assert not seen["above"]
    assert 0 < seen["pauses"] == sum(end - begin > machine.PAUSE for begin, end in seen["intervals"])
    assert seen["intervals"] == sorted(seen["intervals"])
    assert all(
        before - 10**9 < begin < end <= after and end - begin > machine.SLIVER for begin, end in seen["intervals"]
    )
    longest = max(end - begin for begin, end in seen["intervals"]) / 1e6
    assert longest > 40.0 and seen["longest_ms"] == pytest.approx(longest, abs=0.06)
