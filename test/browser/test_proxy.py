"""The page behind a reverse proxy, Debian's nginx, below a path: nothing of it has an address that begins at the server's root."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest
from console_page import ConsolePage
from console_site import ConsoleSite
from playwright.sync_api import expect
from processes import ROOT, free_port, listens, wait_until


@pytest.fixture
def proxied(site: ConsoleSite, tmp_path) -> Iterator[str]:
    """The page's address behind nginx, whose configuration is the one of docs/broker.md with the names of this site."""
    port = free_port()
    (server,) = re.findall(r"^server \{\n.*?^\}$", (ROOT / "docs/broker.md").read_text(), re.MULTILINE | re.DOTALL)
    for there, here in (
        ("listen 443 ssl", f"listen 127.0.0.1:{port} ssl"),
        ("/etc/ssl/twin", str(site.site.folder / "console/console")),
        ("127.0.0.1:8480", f"127.0.0.1:{site.port}"),
    ):
        assert there in server
        server = server.replace(there, here)
    temporary = "".join(
        f"{kind}_temp_path {tmp_path}/{kind};\n" for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    user = "user root;\n" if os.geteuid() == 0 else ""
    configuration = tmp_path / "nginx.conf"
    configuration.write_text(
        f"{user}daemon off;\npid {tmp_path}/pid;\nevents {{}}\nhttp {{\naccess_log off;\n{temporary}{server}\n}}\n"
    )
    process = subprocess.Popen(["/usr/sbin/nginx", "-e", "stderr", "-p", tmp_path, "-c", configuration])
    try:
        wait_until(lambda: listens(port), 10.0, "nginx listening")
        yield f"https://localhost:{port}/cell1/"
    finally:
        process.terminate()
        process.wait(10.0)


def test_the_page_works_below_a_path_behind_a_proxy_and_a_reload_keeps_the_login(browser, site, robot, proxied):
    page = ConsolePage(browser, proxied, picture=True)
    asked: list[str] = []
    page.page.on("request", lambda request: asked.append(urlsplit(request.url).path))
    try:
        # without the slash at the end the proxy adds it
        page.page.goto(proxied.rstrip("/"))
        page.login("ada", site.password("ada"))
        page.wait_drawn("one")
        robot.show_plan()
        page.play_to_end()
        page.hold_approve()
        expect(page.notice).to_contain_text("accepted")
        page.page.reload()
        page.wait_drawn("one")
        expect(page.page.locator(".account")).to_contain_text("ada")
        (cookie,) = page.context.cookies()
        assert (cookie["path"], cookie["httpOnly"], cookie["secure"], cookie["sameSite"]) == (
            "/cell1",
            True,
            True,
            "Strict",
        )
        # script, models, meshes, icon and manifest
        for name in (
            r"main\.\w+\.js",
            r"private/one/robot.urdf",
            r"private/mesh/\w+\.dae",
            "private/rights.json",
        ):
            assert any(re.fullmatch(f"/cell1/{name}", path) for path in asked), name
        addresses = page.page.evaluate(
            "[...document.querySelectorAll('[href], [src]')].map((each) => each.href ?? each.src)"
        )
        outside = [
            path for path in (*asked, *(urlsplit(each).path for each in addresses)) if not path.startswith("/cell1")
        ]
        assert addresses and not outside
        assert not page.errors
    finally:
        page.close()
