"""Paired devices at the console, with real sockets and a real broker: paired once, logged in by PIN, revoked, kept."""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from urllib.request import Request, urlopen

import pytest
from mqtt_packets import packet, text
from piped_console import CONNACK_OK, PING, PONG, broker_with, browser_at, closed, login, serving
from websockets.asyncio.client import connect as websocket
from websockets.exceptions import ConnectionClosed, InvalidStatus

from construction_twin.console.login_pace import PaceLimits
from construction_twin.console.paired import DeviceCookie
from construction_twin.console.pairings import MOST_WRONG, Pairings, Person, hash_of
from construction_twin.console.pipe import BROKER_AWAY, NOT_PAIRED, PIN_ERASED, WRONG_PIN, BrokerAddress
from construction_twin.console.sealing import Cost
from construction_twin.console.server import ServerSettings

PORT, BROKER_PORT, LISTENER_PORT = 28560, 28561, 28562
ADA = Person("ada", "ada-device")
PIN, WRONG = "482139", "482138"
NONE = PaceLimits(account_first_s=0, account_most_s=0, address_first_s=0, address_most_s=0)
MINUTES = PaceLimits(account_first_s=300, account_most_s=300, address_first_s=300, address_most_s=300)
running = partial(serving, port=PORT)


@pytest.fixture(scope="module")
def broker(tmp_path_factory) -> Iterator[None]:
    with broker_with(tmp_path_factory.mktemp("broker"), BROKER_PORT, "ada", "ada-device", "bob"):
        yield


@pytest.fixture
def pairings(tmp_path) -> Pairings:
    return Pairings(tmp_path / "pairings", time.time, Cost(n=16))


def settings(pairings: Pairings | None, port: int = BROKER_PORT, pace: PaceLimits = NONE) -> ServerSettings:
    return ServerSettings({}, None, None, BrokerAddress("127.0.0.1", port), pace=pace, pairings=pairings)


def invited(pairings: Pairings, password: str = "secret") -> str:
    return pairings.invite(ADA, password, "secret")


def at_pair(token: str, cookie: str = "", **more):
    """Return a WebSocket as the page's that pairs."""
    values = {"origin": f"http://127.0.0.1:{PORT}", "subprotocols": ["twin-pair", hash_of(token)], "compression": None}
    values |= {"additional_headers": {"Cookie": cookie} if cookie else {}} | more
    return websocket(f"ws://127.0.0.1:{PORT}/pair", **values)


async def pair(token: str, pin: str = PIN, cookie: str = "", **more) -> tuple[dict, str]:
    """Pair; return the answer, and the cookie as a browser shows it, "" where it got none."""
    async with at_pair(token, cookie, **more) as client:
        given = client.response.headers.get("Set-Cookie", "").split(";")[0]
        await client.send(json.dumps({"token": token, "pin": pin}))
        answer = json.loads(await asyncio.wait_for(client.recv(), 10))
        assert (await closed(client))[0] == 1000
    return answer, given


def at_mqtt(cookie: str):
    return browser_at(PORT, additional_headers={"Cookie": cookie})


def with_pin(pin: str = PIN, user: str = "ada") -> bytes:
    return login(user, f"\0pin:{pin}")


WITHOUT_PIN = partial(login, "ada-device", "\0device")


async def logs_in(client, packets: bytes) -> None:
    await client.send(packets)
    answered, _ = await asyncio.wait({answer := asyncio.ensure_future(client.recv())}, timeout=10)
    assert answered, "no answer: it waits"
    assert answer.result() == CONNACK_OK


async def refused(cookie: str, packets: bytes) -> tuple[int, str]:
    async with at_mqtt(cookie) as client:
        await client.send(packets)
        return await closed(client)


def state(cookie: str) -> dict:
    with urlopen(Request(f"http://127.0.0.1:{PORT}/paired.json", headers={"Cookie": cookie}), timeout=10) as answer:
        assert answer.headers["Cache-Control"] == "no-store"
        return json.loads(answer.read())


def run(scene) -> None:
    asyncio.run(asyncio.wait_for(scene(), 60))


def test_a_device_is_paired_once_and_logs_in_by_pin_and_without(broker, pairings, caplog):
    token = invited(pairings)

    async def scene() -> None:
        async with running(settings(pairings)):
            answer, cookie = await pair(token)
            assert answer == {"ok": True, "number": 1, "account": "ada", "device_account": "ada-device"}
            assert (await pair(token))[0] == {"ok": False, "why": "code"}
            async with at_mqtt(cookie) as sees, at_mqtt(cookie) as person:
                await logs_in(sees, WITHOUT_PIN())
                await logs_in(person, with_pin())
                await person.send(PING)
                assert await asyncio.wait_for(person.recv(), 10) == PONG
            assert await asyncio.to_thread(state, cookie) == {
                "account": "ada", "device_account": "ada-device", "number": 1, "tries": MOST_WRONG,
            }  # fmt: skip
            # whoever has no cookie is nobody's device
            assert (await asyncio.to_thread(state, ""))["account"] == ""

    with caplog.at_level(logging.INFO, "console"):
        run(scene)
    assert "127.0.0.1 paired as device 1 of 'ada'" in caplog.text
    assert "logged in as 'ada-device'" in caplog.text and "logged in as 'ada'" in caplog.text
    assert PIN not in caplog.text and token not in caplog.text


def test_who_has_no_invitation_gets_no_cookie_and_keeps_the_one_that_he_has(broker, pairings):
    async def scene() -> None:
        async with running(settings(pairings)):
            _, cookie = await pair(invited(pairings))
            answer, given = await pair(secrets.token_urlsafe(32), cookie=cookie)
            assert (answer, given) == ({"ok": False, "why": "code"}, "")
            # the hash of an invitation alone is none either
            token = invited(pairings)
            async with at_pair(token) as client:
                await client.send(json.dumps({"token": hash_of(token), "pin": PIN}))
                assert json.loads(await client.recv()) == {"ok": False, "why": "code"}
            assert pairings.is_invited(hash_of(token))
            async with at_mqtt(cookie) as person:
                await logs_in(person, with_pin())

    run(scene)


def test_a_pin_that_is_guessed_first_is_not_taken_and_the_code_stays(broker, pairings):
    async def scene() -> None:
        async with running(settings(pairings)):
            token = invited(pairings)
            assert (await pair(token, "123456"))[0] == {"ok": False, "why": "pin"}
            assert (await pair(token))[0]["ok"]

    run(scene)


@pytest.mark.parametrize(
    "message",
    ("", "[]", "{}", '{"token": 1, "pin": 2}', '{"token": "a", "pin": "b", "more": 1}', "x" * 5000, b"\0",
     '{"token": "\\ud800", "pin": "1"}', "[" * 500),
)  # fmt: skip
def test_a_message_of_another_form_pairs_nobody(broker, pairings, message):
    async def scene() -> None:
        async with running(settings(pairings)):
            token = invited(pairings)
            async with at_pair(token) as client:
                await client.send(message)
                assert json.loads(await asyncio.wait_for(client.recv(), 10)) == {"ok": False, "why": "format"}
            assert pairings.is_invited(hash_of(token)) and pairings.devices() == []

    run(scene)


@pytest.mark.parametrize("more", ({"origin": "http://evil.example"}, {"origin": None}, {"subprotocols": ["mqtt"]}))
def test_a_page_from_elsewhere_pairs_nobody(broker, pairings, more):
    async def scene() -> None:
        async with running(settings(pairings)):
            with pytest.raises(InvalidStatus) as caught:
                await pair(invited(pairings), **more)
            assert caught.value.response.status_code == 403

    run(scene)


def test_a_console_without_a_folder_of_pairings_pairs_nobody_and_changes_no_login(broker, pairings):
    async def scene() -> None:
        async with running(settings(None)):
            with pytest.raises(InvalidStatus) as caught:
                await pair(invited(pairings))
            assert caught.value.response.status_code == 404
            assert (await asyncio.to_thread(state, ""))["account"] == ""
            async with browser_at(PORT) as client:
                await client.send(with_pin())
                assert (await asyncio.wait_for(client.recv(), 10))[3] == 5

    run(scene)


def test_five_wrong_pins_are_the_last_and_the_device_still_stops(broker, pairings, caplog):
    async def scene() -> None:
        async with running(settings(pairings)) as server:
            _, cookie = await pair(invited(pairings))
            for left in range(MOST_WRONG - 1, -1, -1):
                assert (await refused(cookie, with_pin(WRONG)))[0] == WRONG_PIN
                assert (await asyncio.to_thread(state, cookie))["tries"] == left
            assert (await refused(cookie, with_pin()))[0] == PIN_ERASED
            # they are no wrong passwords: the broker has not heard of them
            assert server.wrong_passwords == 0
            async with at_mqtt(cookie) as sees:
                await logs_in(sees, WITHOUT_PIN())

    with caplog.at_level(logging.WARNING, "console"):
        run(scene)
    assert "127.0.0.1: wrong PIN of device 1; 4 more may be tried (as 'ada')" in caplog.text


def test_wrong_pins_at_once_are_counted_one_by_one(broker, pairings):
    async def scene() -> None:
        async with running(settings(pairings)):
            _, cookie = await pair(invited(pairings))
            ends = await asyncio.gather(*(refused(cookie, with_pin(f"70913{number}")) for number in range(8)))
            assert sorted(code for code, _ in ends) == [WRONG_PIN] * 5 + [PIN_ERASED] * 3

    run(scene)


def test_wrong_pins_are_paced_by_device_and_slow_nobody_else(broker, pairings):
    async def scene() -> None:
        async with running(settings(pairings, pace=MINUTES)):
            _, mine = await pair(invited(pairings))
            _, other = await pair(invited(pairings))
            assert (await refused(mine, with_pin(WRONG)))[0] == WRONG_PIN
            async with (
                at_mqtt(mine) as waits,
                at_mqtt(mine) as stops,
                at_mqtt(other) as person,
                browser_at(PORT) as typed,
            ):
                await waits.send(with_pin())
                # another device, and a password, of the same account from the same address
                await logs_in(person, with_pin())
                await logs_in(typed, login("ada"))
                # and what this device may without a PIN
                await logs_in(stops, WITHOUT_PIN())
                with pytest.raises(TimeoutError):
                    await asyncio.wait_for(waits.recv(), 0.2)

    run(scene)


def test_a_cookie_of_another_device_or_of_none_opens_nothing_and_counts_nothing(broker, pairings):
    async def scene() -> None:
        async with running(settings(pairings)):
            _, mine = await pair(invited(pairings))
            _, other = await pair(invited(pairings))
            name, _, value = mine.partition("=")
            mixed = f"{name}={value.split('.')[0]}.{other.split('.')[1]}"
            for cookie in ("", mixed, f"{name}={'0' * 32}.{'a' * 43}", f"{name}=../../secret"):
                for packets in (
                    with_pin(),
                    with_pin(WRONG),
                    WITHOUT_PIN(),
                    login("ada", "\0else"),
                    login("bob", "\0pin:482139"),
                ):
                    assert (await refused(cookie, packets))[0] == NOT_PAIRED
            assert (await refused(mine, with_pin(user="bob")))[0] == NOT_PAIRED
            assert [device.wrong for device in pairings.devices()] == [0, 0]

    run(scene)


@pytest.mark.parametrize("version", (4, 5))
def test_a_login_reaches_the_broker_byte_for_byte_but_for_its_password(pairings, version):
    """A broker that only listens: with a will, properties, and packets behind the login."""
    properties = b"\x05\x11\0\0\0\x0a" if version == 5 else b""
    will = (b"\0" if version == 5 else b"") + text("a/will") + text("gone")

    def made(password: str) -> bytes:
        body = text("MQTT") + bytes([version, 0xC6]) + b"\0\x0a" + properties + text("client") + will + text("ada")
        return packet(1, body + text(password))

    came = bytearray()

    async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(65536):
            came.extend(data)
        writer.close()

    async def scene() -> None:
        async with (
            await asyncio.start_server(take, "127.0.0.1", LISTENER_PORT),
            running(settings(pairings, LISTENER_PORT)),
        ):
            _, cookie = await pair(invited(pairings, password="a much longer password " * 8))
            for sent, expected in (
                (made(f"\0pin:{PIN}"), made("a much longer password " * 8)),
                (made("typed"), made("typed")),
                (made("pin:482139"), made("pin:482139")),
            ):
                came.clear()
                behind = packet(3, text("twin/kr120/view") + b"\0pin:482139")
                async with at_mqtt(cookie) as client:
                    await client.send(sent + behind)
                    await until(lambda expected=expected: len(came) >= len(expected + behind))
                assert bytes(came) == expected + behind

    run(scene)


async def until(condition) -> None:
    end = asyncio.get_running_loop().time() + 10
    while not condition():
        assert asyncio.get_running_loop().time() < end
        await asyncio.sleep(0.01)


@pytest.mark.parametrize("number", (None, 1))
def test_revoking_ends_the_open_sessions_of_those_devices_and_no_others(broker, pairings, number):
    async def scene() -> None:
        async with running(settings(pairings)):
            _, mine = await pair(invited(pairings))
            token = pairings.invite(Person("bob", "ada-device"), "secret", "secret")
            _, other = await pair(token)
            async with at_mqtt(mine) as sees, at_mqtt(mine) as person, at_mqtt(other) as bob, browser_at(PORT) as typed:
                await logs_in(sees, WITHOUT_PIN())
                await logs_in(person, with_pin())
                await logs_in(bob, with_pin(user="bob"))
                await logs_in(typed, login("ada"))
                # as `twin pair` does it, which is another program
                again = Pairings(pairings.folder, time.time, Cost(n=16))
                began = time.monotonic()
                assert len(again.revoke("ada", number)) == 1
                ends = [asyncio.ensure_future(closed(each)) for each in (sees, person)]
                await asyncio.wait(ends, timeout=5)
                assert all(each.done() for each in ends), "still open"
                assert [each.result()[0] for each in ends] == [NOT_PAIRED] * 2
                assert time.monotonic() - began < 5
                for stays in (bob, typed):
                    await stays.send(PING)
                    assert await asyncio.wait_for(stays.recv(), 10) == PONG
            assert (await refused(mine, with_pin()))[0] == NOT_PAIRED
            assert (await refused(mine, WITHOUT_PIN()))[0] == NOT_PAIRED

    run(scene)


def test_a_restart_of_the_console_keeps_pairings_and_wrong_pins_and_no_session(broker, pairings):
    async def scene() -> None:
        async with running(settings(pairings)):
            _, cookie = await pair(invited(pairings))
            for _ in range(3):
                await refused(cookie, with_pin(WRONG))
            person = await at_mqtt(cookie)
            await logs_in(person, WITHOUT_PIN())
        with pytest.raises(ConnectionClosed):
            await asyncio.wait_for(person.recv(), 10)
        async with running(settings(Pairings(pairings.folder, time.time, Cost(n=16)))):
            assert (await asyncio.to_thread(state, cookie))["tries"] == 2
            for _ in range(2):
                assert (await refused(cookie, with_pin(WRONG)))[0] == WRONG_PIN
            assert (await refused(cookie, with_pin()))[0] == PIN_ERASED

    run(scene)


def test_a_password_that_was_replaced_at_the_broker_is_nobody_s_guess(broker, pairings, caplog):
    async def scene() -> None:
        async with running(settings(pairings, pace=MINUTES)) as server:
            _, cookie = await pair(invited(pairings, password="of before"))
            async with at_mqtt(cookie) as client:
                await client.send(with_pin())
                assert (await asyncio.wait_for(client.recv(), 10))[3] == 5
                assert (await closed(client))[0] == BROKER_AWAY
            assert server.wrong_passwords == 0
            async with browser_at(PORT) as typed:
                await logs_in(typed, login("ada"))

    run(scene)
    assert "the broker refuses what is kept for a paired device of 'ada'; pair it again" in caplog.text


def test_an_entry_that_cannot_be_read_lets_nobody_in_and_is_told(broker, pairings, caplog):
    async def scene() -> None:
        async with running(settings(pairings)):
            _, cookie = await pair(invited(pairings))
            device = DeviceCookie.shown(cookie, PORT, False).device
            Path(pairings.folder, "devices", f"{device}.json").write_text("{}")
            assert (await refused(cookie, with_pin()))[0] == NOT_PAIRED
            assert (await asyncio.to_thread(state, cookie))["account"] == ""

    run(scene)
    assert f"{pairings.folder}/devices/" in caplog.text
