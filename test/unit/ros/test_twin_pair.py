"""`twin pair`: the code that it shows pairs one tablet, and it says which; no ROS master is asked."""

from __future__ import annotations

import re
import secrets
import stat
import time
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from PIL import Image
from sentence_checks import expects, says

from construction_twin.broker.access import Person as SitePerson
from construction_twin.broker.access import Site
from construction_twin.broker.make_site import SiteFolder
from construction_twin.console.paired import DeviceCookie, PairingError
from construction_twin.console.pairings import Pairings, hash_of
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, RequestRefused
from construction_twin.ros.commands import twin, twin_line
from construction_twin.ros.commands.twin_pair import PairCommand
from construction_twin.views.arguments import Exit, check, parser

PIN = "482139"


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("pair") / "site"
    persons = (SitePerson.parse("ada:review"), SitePerson.parse("bob:pause"))
    SiteFolder(folder).make(
        Site(("broker.cell",), ("kr120",), folder="/etc/site", persons=persons, consoles=("twin.cell", "192.168.7.20"))
    )
    return folder


@pytest.fixture
def pairings(tmp_path) -> Pairings:
    return Pairings(tmp_path / "pairings", time.time)


def new_cookie() -> DeviceCookie:
    return DeviceCookie(secrets.token_hex(16), secrets.token_urlsafe(32))


def said(capsys) -> str:
    return capsys.readouterr().out


def call(*words: str, sleep=time.sleep) -> Exit:
    options = parser("kr120").parse_args(["pair", *words])
    assert not check(options)
    return PairCommand(options, sleep).run()


def token_of(address: str) -> str:
    fragment = urlsplit(address).fragment
    assert fragment.startswith("pair=")
    return fragment.removeprefix("pair=")


def test_the_code_pairs_the_first_tablet_that_shows_it_and_the_command_says_which(site, tmp_path, pairings, capsys):
    zxingcpp = pytest.importorskip("zxingcpp")
    picture, seen = tmp_path / "code.png", []

    def scan(_: float) -> None:
        assert stat.S_IMODE(picture.stat().st_mode) == 0o600
        with Image.open(picture) as code:
            (found,) = zxingcpp.read_barcodes(code.convert("L"))
        seen.append(found.text)
        pairings.pair(token_of(found.text), PIN, new_cookie(), "192.168.7.99")

    folders = ("--site", str(site), "--pairings", str(pairings.folder))
    assert call("ada", *folders, "--picture", str(picture), sleep=scan) is Exit.DONE
    out = said(capsys)
    assert len(seen) == 1 and seen[0] in out and seen[0].startswith("https://twin.cell:8480/#pair=")
    assert len(token_of(seen[0])) == 43
    assert "paired: device 1 of ada" in out and "from 192.168.7.99" in out
    # as void as the code in it
    assert not picture.exists()
    with pytest.raises(PairingError):
        pairings.pair(token_of(seen[0]), PIN, new_cookie(), "192.168.7.99")


def test_what_it_gives_are_the_passwords_of_the_site(site, pairings, capsys):
    assert (
        call("ada", "--site", str(site), "--pairings", str(pairings.folder), "--no-wait", "--console", "192.168.7.20")
        is Exit.DONE
    )
    found = re.search(r"https://192\.168\.7\.20:8480/\S+", said(capsys))
    cookie = new_cookie()
    pairings.pair(token_of(found[0]), PIN, cookie, "192.168.7.99")
    for account, password in (
        ("ada", pairings.password(cookie, "ada", PIN)),
        ("ada-device", pairings.password_without_pin(cookie, "ada-device")),
    ):
        assert password == (site / "accounts" / account / "password").read_text().strip()


def test_a_code_that_nobody_waits_for_any_more_is_void(site, pairings, capsys):
    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        call("ada", "--site", str(site), "--pairings", str(pairings.folder), sleep=interrupt)
    token = token_of(re.search(r"https://\S+", said(capsys))[0])
    assert not pairings.is_invited(hash_of(token))

    def withdraw(_: float) -> None:
        pairings.revoke("ada")

    with pytest.raises(RequestRefused, check=says("view.pair.unused")):
        call("ada", "--site", str(site), "--pairings", str(pairings.folder), sleep=withdraw)


def test_devices_are_listed_and_revoked_by_name_without_the_site(site, pairings, capsys):
    folder = ("--pairings", str(pairings.folder))
    for name in ("ada", "ada", "bob"):
        call(name, "--site", str(site), *folder, "--no-wait")
        pairings.pair(token_of(re.search(r"https://\S+", said(capsys))[0]), PIN, new_cookie(), "192.168.7.99")
    call("--list", *folder)
    assert [line.split(",")[0] for line in said(capsys).splitlines()] == [
        "device 1 of ada",
        "device 2 of ada",
        "device 3 of bob",
    ]
    call("--revoke", "ada", "--device", "2", *folder)
    assert said(capsys).startswith("revoked: device 2 of ada")
    with pytest.raises(RequestRefused, check=says("view.pair.no_device", number=3)):
        call("--revoke", "ada", "--device", "3", *folder)
    call("--revoke", "ada", *folder)
    assert [each.number for each in pairings.devices()] == [3]
    call("--revoke", "ada", *folder)
    call("ada", "--list", *folder)
    assert "no device is paired" in said(capsys)


def test_who_has_no_account_or_no_address_is_told(site, pairings, tmp_path):
    folders = ("--site", str(site), "--pairings", str(pairings.folder))
    with pytest.raises(ConfigurationError, check=expects("expected.pairings.person")):
        call("eve", *folders)
    with pytest.raises(ConfigurationError, check=expects("expected.one_of", "--console")):
        call("ada", *folders, "--console", "evil.example")
    with pytest.raises(ConfigurationError, check=expects("expected.one_of", "--picture")):
        call("ada", *folders, "--picture", str(tmp_path / "code.pdf"))
    with pytest.raises(ConstructionTwinError, check=says("view.site.none")):
        call("ada", "--site", str(tmp_path / "none"), "--pairings", str(pairings.folder))
    assert not list((pairings.folder / "invitations").iterdir())


def test_an_account_whose_folder_was_handed_out_is_named(tmp_path, pairings):
    folder = tmp_path / "site"
    persons = (SitePerson.parse("ada:review"),)
    SiteFolder(folder).make(
        Site(("broker.cell",), ("kr120",), folder="/etc/site", persons=persons, consoles=("twin.cell",))
    )
    (folder / "accounts/ada/password").unlink()
    with pytest.raises(ConstructionTwinError, check=says("view.site.no_password", account="ada")):
        call("ada", "--site", str(folder), "--pairings", str(pairings.folder))


@pytest.mark.parametrize(
    "words",
    (
        [], ["ada"], ["--list"], ["--revoke", "ada"], ["ada", "--pairings", "/p"], ["--site", "/s"],
        ["ada", "--site", "/s", "--device", "1"], ["--revoke", "ada", "--list", "--site", "/s"],
        ["bob", "--revoke", "ada", "--site", "/s"],
    ),
)  # fmt: skip
def test_what_does_not_fit_together_is_said(words):
    assert check(parser("kr120").parse_args(["pair", *words]))


def test_no_master_is_asked(monkeypatch, site, tmp_path, capsys):
    monkeypatch.setattr(twin, "connect", lambda *_: pytest.fail("asked for a master"))
    assert twin_line.main(["pair", "--list", "--pairings", str(tmp_path / "pairings")]) is Exit.DONE
    assert twin_line.main(["pair", "eve", "--site", str(site), "--pairings", str(tmp_path / "pairings")]) is Exit.USAGE
