"""What breaks, and who is not to be trusted: broker, console and network go away; pages of others, forged and junk frames."""

from __future__ import annotations

import functools
import http.server
import json
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect
from processes import wait_until
from site_broker import Listener

from construction_twin.ros.shared.robot_clock import present

#: Close codes of the pipe (console/pipe.py).
NOT_MQTT, TOO_MUCH = 4002, 4003

#: Opens a WebSocket, sends what `make` returns, and tells how it ended: {opened, code, reason}.
ATTACK = """
async ({url, frames}) => await new Promise((resolve) => {
  const socket = new WebSocket(url, "mqtt");
  socket.binaryType = "arraybuffer";
  let opened = false;
  socket.onopen = () => {
    opened = true;
    for (const frame of frames) socket.send(typeof frame === "string" ? frame : new Uint8Array(frame));
  };
  socket.onclose = ({code, reason}) => resolve({opened, code, reason});
});
"""
#: 10,000 frames of junk on 14 connections, as many as an address may have beside the page's; resolves once all of them have ended.
JUNK = """
async (url) => await Promise.all(Array.from({length: 14}, (_, number) => new Promise((resolve) => {
  const socket = new WebSocket(url, "mqtt");
  let sent = 0;
  socket.onopen = () => {
    for (let k = 0; k < 715; k += 1, sent += 1) {
      const junk = new Uint8Array((number * 13 + k * 7) % 60);
      crypto.getRandomValues(junk);
      socket.send(junk);
    }
  };
  socket.onclose = ({code}) => resolve({sent, code});
})));
"""


def socket_url(site) -> str:
    return site.url.replace("https", "wss") + "mqtt"


def look_at_a_plan(page, robot):
    plan = robot.show_plan()
    page.look()
    return plan


@pytest.fixture
def foreign_page(tmp_path) -> Iterator[str]:
    """The address of a page of another origin, on the same machine."""
    (tmp_path / "index.html").write_text("<!doctype html><title>elsewhere</title>")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(tmp_path))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://localhost:{server.server_address[1]}/"
    server.shutdown()
    thread.join()
    server.server_close()


def test_a_page_of_another_origin_gets_no_connection_and_no_file(page_of, site, robot, foreign_page):
    page = page_of("reviewer-ada")
    # in the same browser, so with the same cookies
    other = page.context.new_page()
    other.goto(foreign_page)
    ended = other.evaluate(ATTACK, {"url": socket_url(site), "frames": []})
    assert (ended["opened"], ended["code"]) == (False, 1006)
    read = other.evaluate(
        "async (url) => { try { return (await fetch(url, {credentials: 'include'})).status } catch { return 'refused' } }",
        site.url + "private/one/robot.urdf",
    )
    assert read == "refused"
    framed = other.evaluate(
        """async (url) => await new Promise((resolve) => {
          const frame = document.createElement("iframe");
          frame.onload = () => { try { resolve(frame.contentDocument?.title ?? "no document") } catch { resolve("no document") } };
          frame.src = url;
          document.body.append(frame);
        })""",
        site.url,
    )
    assert framed == "no document"
    assert f"refused: origin {foreign_page.rstrip('/')!r}" in Path(site.log).read_text()
    # whose page it is stays connected
    expect(page.lost).to_be_hidden()


@pytest.mark.parametrize(
    ("frames", "code"),
    (
        pytest.param(["a text"], NOT_MQTT, id="text"),
        pytest.param([[0x30, 2, 0, 0]], NOT_MQTT, id="PUBLISH before CONNECT"),
        pytest.param([[0x20, 2, 0, 0]], NOT_MQTT, id="CONNACK, which only a broker sends"),
        pytest.param([[0x10, 0xFF, 0xFF, 0xFF, 0xFF, 1]], NOT_MQTT, id="length of five bytes"),
        pytest.param([[0x10, 0xFF, 0xFF, 0x7F]], TOO_MUCH, id="2 MB announced"),
        pytest.param([[0x10, 12, 0, 4, 77, 81, 84, 84, 5, 0, 0, 10, 0, 0]] * 2, NOT_MQTT, id="two CONNECT"),
    ),
)
def test_forged_frames_end_their_own_connection_and_nobody_else_s(page_of, site, robot, frames, code):
    page = page_of("reviewer-ada")
    ended = page.page.evaluate(ATTACK, {"url": socket_url(site), "frames": frames})
    assert (ended["opened"], ended["code"]) == (True, code), ended
    expect(page.lost).to_be_hidden()


def test_ten_thousand_junk_frames_leave_page_and_stop_alive(page_of, site, robot):
    page = page_of("reviewer-ada")
    ends = page.page.evaluate(JUNK, socket_url(site))
    assert sum(end["sent"] for end in ends) > 10_000
    assert {end["code"] for end in ends} <= {NOT_MQTT, TOO_MUCH, 1006}
    expect(page.lost).to_be_hidden()
    page.intervene("stop")
    expect(page.stop_result).to_contain_text("Stop: carried out")


def test_answers_and_states_that_a_person_forges_reach_nobody(page_of, site, robot):
    """Ada's account may publish on its own topics only: the broker takes neither a view nor another's verdict from it."""
    page = page_of("viewer-vic")
    account = site.site.account("one-reviewer-ada")
    forger = Listener(site.site.broker(account), "twin/one/stop/ack", "forger")
    try:
        for topic in (
            "view",
            "screen",
            "plan",
            "review/ack",
            "stop/ack",
            "review/one-reviewer-bob",
            "stop/one-stopper-sam",
        ):
            assert forger.publish(f"twin/one/{topic}", b"{}").value == 135, topic
    finally:
        forger.close()
    expect(page.lost).to_be_hidden()
    assert not robot.payloads("review") and not robot.payloads("stop")


def test_a_console_that_is_restarted_is_found_again_and_nothing_of_before_is_sent(page_of, site, robot):
    page = page_of("reviewer-ada")
    look_at_a_plan(page, robot)
    site.stop_console()
    try:
        expect(page.lost).to_contain_text("NOT CONNECTED")
        page.intervene("stop")
        expect(page.stop_result).to_contain_text("did NOT go out")
        assert page.page.locator(".verdict-approve:enabled").count() == 0
        second = robot.show_plan(goal=robot.twin + 0.2)
    finally:
        site.start_console()
    expect(page.lost).to_be_hidden()
    expect(page.page.locator(".verdict")).to_be_visible()
    # what was looked at is not this plan
    expect(page.approve_button).to_be_disabled()
    page.look()
    page.hold_approve()
    expect(page.notice).to_contain_text("accepted")
    assert [plan for _, _, plan in robot.verdicts] == [second.id]
    assert not robot.payloads("stop")


def test_a_broker_that_is_restarted_is_shown_and_found_again(page_of, site, robot):
    page = page_of("reviewer-ada")
    look_at_a_plan(page, robot)
    page.press_approve()
    site.site.stop()
    try:
        expect(page.lost).to_contain_text("NOT CONNECTED")
        page.page.mouse.up()
        page.intervene("stop")
        expect(page.stop_result).to_contain_text("did NOT go out")
    finally:
        site.site.start()
    expect(page.lost).to_be_hidden()
    # the scripted robot comes back by itself too, with its plan; what was held before does not count
    expect(page.page.locator(".verdict")).to_be_visible()
    expect(page.approve_button).to_be_disabled()
    assert not robot.payloads("review") and not robot.payloads("stop")


def test_a_verdict_on_a_plan_of_before_is_refused_by_the_robot(page_of, site, robot):
    """Not the page's doing: a program that has kept an old plan."""
    page = page_of("reviewer-bob")
    old = robot.show_plan()
    robot.show_plan(goal=robot.twin + 0.2)
    late = Listener(site.site.broker(site.site.account("one-reviewer-ada")), "twin/one/review/ack", "late")
    try:
        fields = {"plan_id": old.id, "plan_hash": old.hash, "verdict": "approved", "moment": str(present())}
        verdict = json.dumps(fields).encode()
        assert not late.publish("twin/one/review/one-reviewer-ada", verdict).is_failure
        wait_until(lambda: late.messages, 60.0, "an answer")
        assert b"is not under review" in late.messages[0][1]
    finally:
        late.close()
    assert not robot.verdicts
    expect(page.page.locator(".verdict")).to_be_visible()


def test_the_policy_keeps_scripts_of_others_and_inline_ones_out(page_of, site, robot):
    page = page_of("viewer-vic")
    ran = page.page.evaluate(
        """async () => {
          const script = document.createElement("script");
          script.textContent = "window.evil = true";
          document.body.append(script);
          const blocked = [];
          for (const url of ["https://localhost:1/x.js", "http://127.0.0.1:1/data"]) {
            try { await fetch(url); } catch { blocked.push(url); }
          }
          return {evil: window.evil ?? false, blocked: blocked.length};
        }"""
    )
    assert ran == {"evil": False, "blocked": 2}
    assert all("Content Security Policy" in error for error in page.errors)
    assert len(page.errors) >= 3
    page.errors.clear()
