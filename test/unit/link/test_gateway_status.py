"""The gateway's status: read strictly, and told as texts on ROS."""

from __future__ import annotations

import json

import pytest
from gateway_cell import following
from tool_cell import ToolCell

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence, templates_of
from construction_twin.link.gateway_status import GatewayStatus, parse_answer, parse_status

TOOL = {
    "name": "frame", "known": True, "reason": "", "outputs": {"vacuum": False}, "inputs": {"reached": True},
    "switches": [{"id": "a", "state": "armed", "reason": ""}],
}  # fmt: skip
STATUS = {
    "state": "ready", "reason": "", "counters": {"telegrams": 3}, "reply_us": {"max": 1.5, "bins": [1, 2], "counts": [0, 3]},
    "tool": TOOL,
}  # fmt: skip


def parsed(status: dict) -> GatewayStatus:
    return parse_status(json.dumps(status).encode())


def test_it_shows_what_a_real_gateway_says():
    cell = following()
    cell.arm("other")
    values = parsed(cell.gateway.status()).text_values()
    assert values["playout_delay_ms"] == "20" and values["playout_lead_ms"] == "16"
    assert values["playout_rate_percent"] == "0"
    assert (values["intruder_session"], values["intruder_count"]) == ("other", "1")
    assert values["last_refusal"].startswith("arm: armed for session s1") and values["mode"] == "normal"
    assert values["last_ipoc_jump_ms"] == "0"
    cell = ToolCell().follow()
    assert cell.ask(True, id="grip")[0]
    read_, sent = parsed(cell.gateway.status()), cell.gateway.status()
    assert read_.tool.outputs == sent["tool"]["outputs"] and [each.id for each in read_.tool.switches] == ["grip"]


def test_status_and_answer_are_read_and_an_older_gateway_s_says_nothing():
    assert STATUS.items() <= parsed(STATUS).model_dump(exclude_unset=True).items()
    answer = parse_answer(b'{"id": "1", "ok": true}')
    assert (answer.id, answer.ok, answer.reason) == ("1", True, "")
    assert parsed({"state": "ready"}).text_values() == {}


@pytest.mark.parametrize(
    "change",
    [
        {"state": 5}, {"state": None}, {"run": 5}, {"run": None}, {"run": "r" * 65}, {"run": "two\nlines"}, {"fault": "no"},
        {"fault": 0}, {"fault_number": -1}, {"fault_number": 1.5}, {"protocol": "2"}, {"counters": 5},
        *({"counters": {"telegrams": count}} for count in ("many", -1, 1 << 64)),
        {"reply_us": [1]}, {"reply_us": {"bins": 5}}, {"reply_us": {"counts": [1.5]}},
        {"playout": 3}, {"playout": [1]}, {"playout": {str(k): 1 for k in range(33)}}, {"playout": {"x" * 65: 1}},
        *({"playout": {"delay_ms": value}} for value in ([1], True, float("nan"), float("inf"), 10**400, {})),
        {"intruder": {"count": -(1 << 63)}}, {"intruder": {"session": {}}}, {"last_refusal": ["x"]},
        {"session": None}, {"hash": None}, {"decimals": "3"}, {"connection": -1}, {"stop": "silence"}, {"stop": None},
        {"stop": {"moved_deg": ["x"]}}, {"stop": {"moved_deg": [0.0] * 13}},
        *({"tool": tool} for tool in (None, 5, [], {})),
        *(
            {"tool": TOOL | tool}
            for tool in (
                {"known": 1}, {"outputs": {"vacuum": 1}}, {"name": 3}, {"inputs": []}, {"switches": [{}]}, {"switches": [5]},
                *({"switches": [{"id": "a", "state": word, "reason": ""}]} for word in ("pending", "asked", "ARMED", ["armed"])),
                {"switches": [{"id": 5, "state": "armed", "reason": ""}]}, {"switches": [{}] * 17}, {"reason": None},
                {"outputs": {str(n): True for n in range(17)}},
            )
        ),
    ],
)  # fmt: skip
def test_what_is_not_in_the_interface_is_refused(change):
    with pytest.raises(PayloadError, match="is not what the interface says") as caught:
        parsed(STATUS | change)
    assert caught.value.reason == "status"


@pytest.mark.parametrize("payload", [b"", b"[1]", b"{" * 10_000, b" " * ((1 << 20) + 1)])
def test_a_status_that_is_no_json_object_is_refused(payload):
    with pytest.raises(PayloadError) as caught:
        parse_status(payload)
    assert caught.value.reason == "status"


def test_long_texts_are_cut():
    assert len(parsed({"last_refusal": "x" * 10_000}).text_values()["last_refusal"]) == 300


def test_what_it_says_can_be_said_in_another_language():
    said = {"gateway is braking": {"template": "gateway is {state}", "values": {"state": "braking"}}}
    found = parsed(
        STATUS
        | {"reason": "gateway is braking", "controller": {"sentence": "gateway is braking"}, "said": said}
        | {"tool": TOOL | {"switches": [{"id": "a", "state": "armed", "reason": "gateway is braking"}]}}
    )
    for text in (found.reason, found.controller_sentence, found.tool.switches[0].reason):
        assert isinstance(text, Sentence) and (text.template, text.values) == (
            "gateway is {state}",
            {"state": "braking"},
        )


@pytest.mark.parametrize(
    "said",
    [
        None, 5, [], "x",
        *(
            {"the text": sentence}
            for sentence in (
                None, 5, [], {"template": "{x}", "values": {}}, {"template": "{", "values": {}},
                {"template": "{x}", "values": {"x": 1}}, {"template": "{x.real}", "values": {"x.real": "another text"}},
                {"template": "{x}{x}", "values": {"x": "the text"}}, {"template": "{x}", "values": ["x"]},
            )
        ),
        # each would hold the one before twice
        {"the text": {"template": "{x}" * 100_000, "values": {"x": "a" * 500_000}}},
        {"the text": {"template": "{x:" + "f" * 900_000 + "}", "values": {"x": "the text"}}},
        {"a" * k: {"template": "{x}{y}", "values": {"x": "a" * (k - 1), "y": "a" * (k - 1)}} for k in range(2, 200)},
    ],
)  # fmt: skip
def test_a_text_that_its_template_does_not_make_is_a_text_alone(said):
    for reason in ("the text", "a" * 199):
        found = parsed(STATUS | {"reason": reason, "said": said})
        assert found.reason == reason and type(found.reason) is str


def test_sentences_in_each_other_and_lists_in_lists_are_read_without_end():
    said = {"a" * k: {"template": "a{x}", "values": {"x": "a" * (k - 1)}} for k in range(2, 250)}
    deep = json.loads("[" * 700 + "]" * 700)
    found = parsed({"state": "ready", "reason": "a" * 249, "said": said, "other": deep})
    assert found.reason == "a" * 249 and len(templates_of(found.reason)) <= 20
    assert len(parsed({"reason": "x" * 100_000}).reason) == 2000


def test_a_bare_plc_s_words_are_told_from_a_gateway_s_status():
    for word in ("ready", "offline"):
        found = parse_status(word.encode())
        assert (found.state, found.kind) == (word, "plc")
    # what a gateway's JSON says of its kind does not count
    assert parse_status(b'{"state": "ready", "kind": "plc"}').kind == "rsi"
    for other in (b"Ready", b"ready ", b"ready\n", b"READY", b"armed", b"", b'"ready"'):
        with pytest.raises(PayloadError) as refused:
            parse_status(other)
        assert refused.value.reason == "status"
