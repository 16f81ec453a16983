"""The folder of pairings, and the PINs that may be chosen: what is kept, what opens it, and what is counted."""

from __future__ import annotations

import json
import os
import re
import secrets
import stat
import threading
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from sentence_checks import expects

from construction_twin.console import pairings_folder
from construction_twin.console.paired import COOKIE_S, DeviceCookie, PairingError, is_marked
from construction_twin.console.pairings import INVITED_S, MOST_WRONG, Device, Pairings, Person, hash_of
from construction_twin.console.pairings_folder import check_pairings_folder
from construction_twin.console.pin import DIFFERENT, LONGEST, SHORTEST, refusal
from construction_twin.console.sealing import Cost, key_of_device, key_of_pin, seal, unseal
from construction_twin.core.errors import ConfigurationError

PINS = json.loads((Path(__file__).resolve().parents[2] / "data/pins.json").read_text())
ADA = Person("ada", "ada-device")
PIN, WRONG = "482139", "482138"
#: What tests can wait for.
CHEAP = Cost(n=16)


class Clock:
    """A clock that stands."""

    def __init__(self):
        self.now = 1_000_000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def folder(tmp_path) -> Path:
    return tmp_path / "pairings"


@pytest.fixture
def pairings(folder, clock) -> Pairings:
    return Pairings(folder, clock, CHEAP)


def new_cookie() -> DeviceCookie:
    return DeviceCookie(secrets.token_hex(16), secrets.token_urlsafe(32))


def paired(pairings: Pairings, cookie: DeviceCookie | None = None, person: Person = ADA) -> tuple[DeviceCookie, Device]:
    """Pair a device; `of` and `device` are the passwords."""
    cookie = cookie or new_cookie()
    token = pairings.invite(person, f"of {person.account}", f"device of {person.account}")
    return cookie, pairings.pair(token, PIN, cookie, "192.0.2.7")


def why(function, *arguments) -> str:
    with pytest.raises(PairingError) as caught:
        function(*arguments)
    return caught.value.why


# -- PINs


@pytest.mark.parametrize("pin", PINS)
def test_a_pin_that_is_guessed_first_is_refused(pin):
    assert refusal(pin) == PINS[pin]


@given(st.text("0123456789", min_size=SHORTEST, max_size=LONGEST))
@example("890123")
def test_every_row_and_every_repeated_group_is_refused_and_nothing_of_enough_digits_else(pin):
    numbers = [int(digit) for digit in pin]
    row = any(all((b - a) % 10 == step for a, b in zip(numbers, numbers[1:])) for step in (1, 9))
    repeated = any(pin[:length] * (len(pin) // length) == pin for length in range(1, len(pin)))
    assert bool(refusal(pin)) == (len(set(pin)) < DIFFERENT or row or repeated)


# -- the cookie


def test_a_cookie_is_for_this_server_s_own_requests_only():
    cookie = new_cookie()
    header = cookie.header(8480, secure=True)
    assert header.startswith("__Host-console_device_8480=")
    assert {"Path=/", "HttpOnly", "SameSite=Strict", "Secure", f"Max-Age={COOKIE_S}"} <= set(header.split("; "))
    pair = header.split(";")[0]
    assert DeviceCookie.shown(f"a=b; {pair}; c", 8480, True) == cookie
    # of another port, or planted without TLS
    assert DeviceCookie.shown(pair, 8481, True) is None
    assert DeviceCookie.shown(cookie.header(8480, False).split(";")[0], 8480, True) is None
    assert cookie.secret not in repr(cookie)


@pytest.mark.parametrize(
    "value", ("", "x", "../../secret." + "a" * 43, "A" * 32 + "." + "a" * 43, "a" * 32 + "." + "/" * 43)
)
def test_a_cookie_that_is_none_of_ours_is_nobody(value):
    assert DeviceCookie.shown(f"console_device_1={value}", 1, False) is None
    assert DeviceCookie.shown(None, 1, False) is None


def test_no_password_that_make_site_makes_or_a_person_types_asks_for_another_one():
    assert not any(map(is_marked, (None, b"", b"pin:482139", secrets.token_urlsafe(24).encode())))
    assert is_marked(b"\0pin:482139") and is_marked(b"\0device")


# -- encryption


@given(st.text(max_size=60), st.integers(0, 200), st.integers(0, 7))
def test_what_is_sealed_opens_with_its_key_and_for_its_purpose_only(text, place, bit):
    key = secrets.token_bytes(32)
    sealed = bytearray(seal(key, secrets.token_bytes(12), text, "device 1"))
    assert unseal(key, bytes(sealed), "device 1") == text
    assert unseal(secrets.token_bytes(32), bytes(sealed), "device 1") is None
    assert unseal(key, bytes(sealed), "device 2") is None
    sealed[place % len(sealed)] ^= 1 << bit
    assert unseal(key, bytes(sealed), "device 1") is None
    assert unseal(key, b"", "device 1") is None


# -- invitations


def test_an_invitation_is_used_once(pairings, folder):
    token = pairings.invite(ADA, "secret", "device secret")
    assert pairings.is_invited(hash_of(token))
    cookie = new_cookie()
    device = pairings.pair(token, PIN, cookie, "192.0.2.7")
    assert (device.account, device.device_account, device.number) == ("ada", "ada-device", 1)
    assert pairings.password(cookie, "ada", PIN) == "secret"
    assert pairings.password_without_pin(cookie, "ada-device") == "device secret"
    assert not pairings.is_invited(hash_of(token))
    assert why(pairings.pair, token, PIN, new_cookie(), "192.0.2.8") == "code"
    assert len(pairings.devices()) == 1 and pairings.paired_with(hash_of(token)) == pairings.devices()[0]


def test_two_who_use_an_invitation_at_once_are_one(pairings, folder, clock):
    token = pairings.invite(ADA, "secret", "device secret")
    others = [Pairings(folder, clock, CHEAP) for _ in range(8)]
    answers: list[str] = []

    def use(own: Pairings) -> None:
        try:
            answers.append(own.pair(token, PIN, new_cookie(), "192.0.2.7").account)
        except PairingError as error:
            answers.append(error.why)

    threads = [threading.Thread(target=use, args=(own,)) for own in others]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answers) == ["ada"] + ["code"] * 7


@pytest.mark.parametrize("later", (INVITED_S, INVITED_S * 100, -3600.0))
def test_an_invitation_that_is_too_old_or_of_another_clock_is_none(pairings, clock, later):
    token = pairings.invite(ADA, "secret", "device secret")
    clock.now += later
    assert not pairings.is_invited(hash_of(token))
    assert why(pairings.pair, token, PIN, new_cookie(), "192.0.2.7") == "code"
    assert pairings.devices() == []


def test_an_invitation_lasts_until_its_end_and_is_taken_away_with_the_next_one(pairings, clock, folder):
    token = pairings.invite(ADA, "secret", "device secret")
    clock.now += INVITED_S - 0.1
    assert pairings.is_invited(hash_of(token))
    clock.now += 0.2
    pairings.invite(ADA, "secret", "device secret")
    assert len(list((folder / "invitations").iterdir())) == 1


@pytest.mark.parametrize("token", ("", "x", "../../devices/a", "\0", "a" * 300))
def test_another_token_opens_nothing(pairings, token):
    made = pairings.invite(ADA, "secret", "device secret")
    assert why(pairings.pair, token, PIN, new_cookie(), "192.0.2.7") == "code"
    assert not pairings.is_invited(token)
    assert pairings.is_invited(hash_of(made))


def test_a_pin_that_may_not_be_chosen_leaves_the_invitation(pairings):
    token = pairings.invite(ADA, "secret", "device secret")
    assert why(pairings.pair, token, "123456", new_cookie(), "192.0.2.7") == "pin"
    assert pairings.is_invited(hash_of(token)) and pairings.devices() == []


def test_an_invitation_that_was_withdrawn_is_none(pairings):
    token = pairings.invite(ADA, "secret", "device secret")
    pairings.withdraw(hash_of(token))
    assert why(pairings.pair, token, PIN, new_cookie(), "192.0.2.7") == "code"


def test_an_invitation_cannot_be_made_to_last_longer_or_be_another_s(pairings, folder, clock):
    for field, value in (("expires", clock.now + 1e6), ("account", "bob"), ("device_account", "bob-device")):
        token = pairings.invite(ADA, "secret", "device secret")
        path = folder / "invitations" / f"{hash_of(token)}.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | {field: value}))
        assert why(pairings.pair, token, PIN, new_cookie(), "192.0.2.7") == "code", field


# -- what is on the disk


def test_nothing_in_the_folder_is_a_secret_of_somebody_else_and_nobody_else_may_read_it(pairings, folder):
    token = pairings.invite(ADA, "ada's own password", "the device's password")
    cookie, _ = paired(pairings)
    said = "".join(path.read_text() for path in folder.rglob("*") if path.is_file())
    for secret in (token, "ada's own", "the device's", "of ada", PIN, cookie.secret):
        assert secret not in said
    for path in (folder, *folder.rglob("*")):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path
    assert not [path for path in folder.rglob(".*")]


@pytest.mark.parametrize("mode", (0o750, 0o701, 0o777))
def test_a_folder_that_others_may_read_is_refused(folder, mode):
    folder.mkdir()
    folder.chmod(mode)
    with pytest.raises(ConfigurationError, check=expects("expected.pairings.private", "--pairings")):
        Pairings(folder, Clock())


def test_a_folder_that_cannot_be_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, check=expects("expected.pairings.folder", "--pairings")):
        Pairings(tmp_path / "file" / "pairings", Clock())


def test_a_folder_of_somebody_else_is_refused_with_whose_it_should_be(folder, monkeypatch):
    Pairings(folder, Clock())
    other = os.geteuid() + 1
    monkeypatch.setattr(pairings_folder.os, "geteuid", lambda: other)
    with pytest.raises(ConfigurationError, check=expects("expected.pairings.owner", "--pairings")):
        Pairings(folder, Clock())


@pytest.mark.parametrize("name", ("secret", "lock", "invitations", "devices", "devices/1.json"))
def test_a_folder_with_something_that_cannot_be_used_is_refused_with_what(folder, monkeypatch, name):
    Pairings(folder, Clock())
    (folder / "devices/1.json").write_text("{}")
    check_pairings_folder(folder)
    monkeypatch.setattr(pairings_folder.os, "access", lambda path, mode: path != folder / name)
    with pytest.raises(ConfigurationError, match=re.escape(str(folder / name))) as caught:
        Pairings(folder, Clock())
    assert expects("expected.pairings.usable", "--pairings")(caught.value)


def test_looking_at_a_folder_makes_and_changes_nothing(folder):
    check_pairings_folder(folder)
    assert not folder.exists()
    Pairings(folder, Clock())
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    check_pairings_folder(folder)
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


# -- devices


def test_an_entry_opens_with_its_own_cookie_only(pairings):
    mine, _ = paired(pairings)
    other, _ = paired(pairings)
    for cookie in (
        None,
        new_cookie(),
        DeviceCookie(mine.device, other.secret),
        DeviceCookie(other.device, mine.secret),
    ):
        assert pairings.device_of(cookie) is None
        assert why(pairings.password, cookie, "ada", PIN) == "device"
        assert why(pairings.password_without_pin, cookie, "ada-device") == "device"
    # and who has another one cannot have anybody's PIN erased
    assert [device.wrong for device in pairings.devices()] == [0, 0]


def test_an_entry_that_was_copied_beside_another_or_of_another_console_is_of_no_use(pairings, folder, tmp_path, clock):
    cookie, device = paired(pairings)
    text = (folder / "devices" / f"{device.device}.json").read_text()
    mine = new_cookie()
    copied = folder / "devices" / f"{mine.device}.json"
    # as somebody who may write there would name it
    for content in (text, text.replace(device.device, mine.device)):
        copied.write_text(content)
        assert pairings.device_of(mine) is None
        assert pairings.device_of(DeviceCookie(mine.device, cookie.secret)) is None
    elsewhere = Pairings(tmp_path / "elsewhere", clock, CHEAP)
    (tmp_path / "elsewhere/devices" / f"{device.device}.json").write_text(text)
    assert elsewhere.device_of(cookie) is None


def test_what_the_pin_opens_needs_the_cookie_the_console_s_secret_and_the_pin():
    """Each of them alone is somewhere else: on the tablet, in the folder, in a head."""
    own, cookie, salt = (secrets.token_bytes(32) for _ in range(3))
    key = key_of_pin(own, cookie, "device", PIN, salt, CHEAP)
    assert key == key_of_pin(own, cookie, "device", PIN, salt, CHEAP)
    others = [
        key_of_pin(secrets.token_bytes(32), cookie, "device", PIN, salt, CHEAP),
        key_of_pin(own, secrets.token_bytes(32), "device", PIN, salt, CHEAP),
        key_of_pin(own, cookie, "another", PIN, salt, CHEAP),
        key_of_pin(own, cookie, "device", WRONG, salt, CHEAP),
        key_of_pin(own, cookie, "device", PIN, secrets.token_bytes(32), CHEAP),
        key_of_device(own, cookie, "device"),
    ]
    assert key not in others and len(set(others)) == len(others)
    # what a try costs is for real: 128 MB
    assert Cost().n * Cost().r * 128 == 2**27


def test_a_device_logs_in_to_its_own_accounts_only(pairings):
    cookie, _ = paired(pairings)
    assert why(pairings.password, cookie, "bob", PIN) == "device"
    assert why(pairings.password, cookie, "ada-device", PIN) == "device"
    assert why(pairings.password_without_pin, cookie, "ada") == "device"
    assert pairings.devices()[0].wrong == 0


def test_five_wrong_pins_erase_what_the_pin_opens_and_nothing_else(pairings, folder):
    cookie, device = paired(pairings)
    for left in range(MOST_WRONG - 1, -1, -1):
        with pytest.raises(PairingError) as caught:
            pairings.password(cookie, "ada", WRONG)
        assert (caught.value.why, caught.value.left) == ("wrong", left)
    assert json.loads((folder / "devices" / f"{device.device}.json").read_text())["pin_sealed"] == ""
    assert why(pairings.password, cookie, "ada", PIN) == "erased"
    found = pairings.device_of(cookie)
    assert found is not None and (found.has_pin, found.left) == (False, 0)
    # whoever holds it still stops
    assert pairings.password_without_pin(cookie, "ada-device") == "device of ada"


def test_a_right_pin_forgets_the_wrong_ones_before_it(pairings):
    cookie, _ = paired(pairings)
    for _ in range(3):
        for _ in range(MOST_WRONG - 1):
            assert why(pairings.password, cookie, "ada", WRONG) == "wrong"
        assert pairings.password(cookie, "ada", PIN) == "of ada"
        assert pairings.devices()[0].wrong == 0


def test_a_try_is_on_the_disk_before_it_is_made(pairings, folder, clock, monkeypatch):
    """The power fails while the key is computed, or somebody ends the console: the try counts."""
    cookie, _ = paired(pairings)

    def power_cut(*_):
        raise KeyboardInterrupt

    for tries in range(1, MOST_WRONG + 1):
        monkeypatch.setattr("construction_twin.console.pairings.key_of_pin", power_cut)
        with pytest.raises(KeyboardInterrupt):
            pairings.password(cookie, "ada", WRONG)
        monkeypatch.undo()
        pairings = Pairings(folder, clock, CHEAP)
        assert pairings.devices()[0].wrong == tries
    assert why(pairings.password, cookie, "ada", PIN) == "erased"
    assert pairings.devices()[0].pin_sealed == ""


def test_wrong_pins_at_once_are_no_more_than_one_after_the_other(folder, clock):
    cookie, _ = paired(Pairings(folder, clock, CHEAP))
    answers: list[str] = []
    begin = threading.Barrier(20)

    def guess(number: int) -> None:
        own = Pairings(folder, clock, CHEAP)
        begin.wait()
        answers.append(why(own.password, cookie, "ada", f"70913{number:02}"))

    threads = [threading.Thread(target=guess, args=(number,)) for number in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answers) == ["erased"] * 15 + ["wrong"] * 5


def test_a_pairing_outlasts_the_console_and_its_numbers_are_given_once(folder, clock):
    cookie, first = paired(Pairings(folder, clock, CHEAP))
    again = Pairings(folder, clock, CHEAP)
    assert again.password(cookie, "ada", PIN) == "of ada"
    again.revoke("ada")
    assert paired(again)[1].number == first.number + 1


def test_what_is_revoked_by_name_is_gone_with_its_codes_and_others_stay(pairings):
    mine = [paired(pairings) for _ in range(2)]
    bob, _ = paired(pairings, person=Person("bob", "bob-device"))
    token, other = pairings.invite(ADA, "a", "b"), pairings.invite(Person("bob", "bob-device"), "a", "b")
    assert [each.number for each in pairings.revoke("ada", 2)] == [2]
    assert pairings.is_invited(hash_of(token))
    assert pairings.device_of(mine[0][0]) is not None and not pairings.is_paired(mine[1][1].device)
    assert pairings.revoke("ada", 2) == []
    assert [each.number for each in pairings.revoke("ada")] == [1]
    assert why(pairings.password, mine[0][0], "ada", PIN) == "device"
    assert not pairings.is_invited(hash_of(token)) and pairings.is_invited(hash_of(other))
    assert pairings.password(bob, "bob", PIN) == "of bob"


def test_a_device_that_is_paired_anew_has_one_entry(pairings):
    former, _ = paired(pairings)
    token, cookie = pairings.invite(Person("bob", "bob-device"), "of bob", "device of bob"), new_cookie()
    pairings.pair(token, PIN, cookie, "192.0.2.7", former)
    assert [each.account for each in pairings.devices()] == ["bob"]
    # who only says that he was that device takes nothing away
    token = pairings.invite(ADA, "a", "b")
    pairings.pair(token, PIN, new_cookie(), "192.0.2.8", DeviceCookie(cookie.device, former.secret))
    assert [each.account for each in pairings.devices()] == ["bob", "ada"]


def test_a_file_that_is_none_of_ours_is_named_and_holds_up_no_revocation(pairings, folder):
    cookie, _ = paired(pairings)
    broken = folder / "devices" / f"{'0' * 32}.json"
    broken.write_text("{}")
    assert str(broken) in pairings.unreadable()[0]
    assert [each.account for each in pairings.revoke("ada")] == ["ada"]
