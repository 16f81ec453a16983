"""What breaks, and who is not to be trusted: broker, console and network go away; pages of others, forged and junk frames."""

from __future__ import annotations

import functools
import http.server
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect

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
    page = page_of("ada")
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


def test_a_console_that_is_restarted_is_found_again_and_nothing_of_before_is_sent(page_of, site, robot):
    page = page_of("ada")
    look_at_a_plan(page, robot)
    site.stop_console()
    try:
        expect(page.lost).to_contain_text("NOT CONNECTED")
        page.intervene("stop")
        expect(page.stop_result).to_contain_text("did NOT go out")
        # white on red
        expect(page.stop_result).to_have_css("background-color", "rgb(195, 17, 31)")
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


def test_the_policy_keeps_scripts_of_others_and_inline_ones_out(page_of, site, robot):
    page = page_of("vic")
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
