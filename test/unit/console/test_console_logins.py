"""Logins through the console, with real sockets and a real broker: who waits after wrong passwords, who has a place, what is told.

Where a test says that somebody does not wait, whoever waits waits for minutes: what comes at all comes without waiting.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Iterator
from functools import partial

import pytest
from mqtt_packets import connect, packet, text
from piped_console import CONNACK_OK, PING, PONG, broker_with, browser_at, closed, login, serving
from websockets.exceptions import ConnectionClosed

from construction_twin.console.connection_limits import ConnectionLimits
from construction_twin.console.login_pace import PaceLimits
from construction_twin.console.logins import shown
from construction_twin.console.pipe import BROKER_AWAY, BrokerAddress, PipeLimits
from construction_twin.console.server import ConsoleServer, ServerSettings

PORT, BROKER_PORT, SILENT_PORT = 28470, 28471, 28472
STRANGER = "127.0.0.2"
#: Longer than any test.
MINUTES = PaceLimits(account_first_s=300, account_most_s=300, address_first_s=300, address_most_s=300)
SHORT = PaceLimits(account_first_s=0.5, account_most_s=0.5, address_first_s=0.1, address_most_s=0.1)
NONE = PaceLimits(account_first_s=0, account_most_s=0, address_first_s=0, address_most_s=0)
running = partial(serving, port=PORT)
browser = partial(browser_at, PORT)


@pytest.fixture(scope="module")
def broker(tmp_path_factory) -> Iterator[None]:
    with broker_with(tmp_path_factory.mktemp("broker"), BROKER_PORT, "ada", "bob"):
        yield


def settings(pace: PaceLimits = MINUTES, port: int = BROKER_PORT, **more) -> ServerSettings:
    return ServerSettings({}, None, None, BrokerAddress("127.0.0.1", port), pace=pace, **more)


async def fail(account: str = "ada", address: str = "127.0.0.1") -> None:
    """Log in with a wrong password, and see it refused."""
    async with browser(address) as client:
        await client.send(login(account, "guess"))
        assert (await asyncio.wait_for(client.recv(), 10))[3] == 5
        assert await closed(client) == (BROKER_AWAY, "the broker has refused the login")


async def logs_in(client, account: str = "ada") -> None:
    await client.send(login(account))
    assert await asyncio.wait_for(client.recv(), 10) == CONNACK_OK


async def answers(client) -> None:
    await client.send(PING)
    assert await asyncio.wait_for(client.recv(), 10) == PONG


@contextlib.asynccontextmanager
async def silent_broker() -> AsyncIterator[list[bytes]]:
    """A broker that takes everything and says nothing; gives what each connection had sent by its end."""
    ended: list[bytes] = []

    async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError):
            ended.append(b"")
            number = len(ended) - 1
            while data := await reader.read(65536):
                ended[number] += data
        ended[number] += b" end"
        writer.close()

    async with await asyncio.start_server(take, "127.0.0.1", SILENT_PORT):
        yield ended


async def until(condition) -> None:
    end = asyncio.get_running_loop().time() + 10
    while not condition():
        assert asyncio.get_running_loop().time() < end
        await asyncio.sleep(0.01)


def test_after_a_wrong_password_its_address_waits_and_nobody_else(broker):
    async def scene() -> None:
        async with (
            running(settings()) as server,
            browser() as open_session,
            browser() as again,
            browser(STRANGER) as elsewhere,
        ):
            await logs_in(open_session)
            await fail()
            assert server.wrong_passwords == 1
            await again.send(login())
            # the same account from another address, the page's first attempt, and who is in already
            await logs_in(elsewhere)
            async with browser() as first:
                await first.send(connect(version=5))
                assert (await asyncio.wait_for(first.recv(), 10))[3] == 0x87
            await answers(open_session)
            assert server.wrong_passwords == 1
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(again.recv(), 0.2)
            await again.close()

    asyncio.run(scene())


def test_a_login_that_waited_comes_through_with_all_that_came_behind_it(broker, caplog):
    async def scene() -> None:
        async with running(settings(SHORT)) as server:
            await fail()
            await fail()
            async with browser() as client:
                await client.send(login() + PING)
                await client.send(PING)
                came = b""
                while len(came) < 8:
                    came += await asyncio.wait_for(client.recv(), 10)
                assert came == CONNACK_OK + PONG + PONG
            assert server.wrong_passwords == 2

    with caplog.at_level(logging.INFO, "console"):
        asyncio.run(scene())
    assert "127.0.0.1 logged in as 'ada'; wrong passwords from there before: 2" in caplog.text


def test_a_wait_is_as_long_as_the_pace_says(broker):
    async def scene() -> None:
        async with running(settings(SHORT)):
            await fail()
            clock = asyncio.get_running_loop().time
            async with browser() as client:
                began = clock()
                await logs_in(client)
                assert clock() - began >= 0.5
            # one wait too few would be seen, one too many ends the test
            async with browser() as client:
                await logs_in(client)

    asyncio.run(scene())


def test_who_is_an_account_s_stranger_at_its_own_address_slows_it_less(broker):
    """Behind a shared address: wrong passwords of one account, and the login of another."""
    pace = PaceLimits(account_first_s=300, account_most_s=300, address_first_s=0.1, address_most_s=0.1)

    async def scene() -> None:
        async with running(settings(pace)), browser() as bob:
            await fail("ada")
            await logs_in(bob, "bob")

    asyncio.run(scene())


def test_of_a_browser_that_leaves_while_it_waits_nothing_reaches_the_broker(broker):
    async def scene() -> None:
        async with silent_broker() as sent, running(settings(SHORT, SILENT_PORT)) as server:
            # its answer is not waited for: what came with it would be carried out all the same
            async with browser() as client:
                await client.send(login(password="guess"))
                await until(lambda: any(sent))
            await until(lambda: server.wrong_passwords == 1)
        async with silent_broker() as sent, running(settings(MINUTES, SILENT_PORT)) as server:
            async with browser() as client:
                await client.send(login(password="guess"))
                await until(lambda: any(sent))
            await until(lambda: server.wrong_passwords == 1)
            async with browser() as client:
                await client.send(login() + packet(3, text("twin/kr120/stop/ada") + b"{}"))
                await until(lambda: len(sent) == 2)
            await until(lambda: sent[1] == b" end")
            assert server.wrong_passwords == 1

    asyncio.run(scene())


@pytest.mark.parametrize("then", ("leaves", "sends what is no MQTT"))
def test_who_does_not_wait_for_the_answer_has_guessed_all_the_same(then, caplog):
    async def scene() -> None:
        async with silent_broker() as sent, running(settings(NONE, SILENT_PORT)) as server, browser() as client:
            await client.send(login(password="guess") + packet(3, text("twin/kr120/stop/ada") + b"{}"))
            await until(lambda: any(sent))
            if then == "leaves":
                await client.close()
            else:
                await client.send(b"junk")
            await until(lambda: server.wrong_passwords == 1)
            # the page's own attempt holds no password
            async with browser() as first:
                await first.send(connect(version=5))
                await until(lambda: len(sent) == 2 and sent[1])
            await until(lambda: sent[1].endswith(b" end"))
            assert server.wrong_passwords == 1

    asyncio.run(scene())
    assert "127.0.0.1: left before the broker's answer, which counts as a wrong password for 'ada'" in caplog.text


def test_a_broker_that_goes_away_makes_no_password_wrong():
    async def hang_up(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(100)
        writer.close()

    async def scene() -> None:
        async with await asyncio.start_server(hang_up, "127.0.0.1", SILENT_PORT):
            async with running(settings(port=SILENT_PORT)) as server, browser() as client:
                await client.send(login())
                assert (await closed(client))[0] == BROKER_AWAY
                assert server.wrong_passwords == 0

    asyncio.run(scene())


def test_a_flood_of_connections_ends_no_login_that_waits_at_the_same_address(broker):
    limits = ConnectionLimits(anonymous=24, anonymous_per_address=4)

    async def scene() -> None:
        async with running(settings(SHORT, connections=limits)):
            await fail()
            async with browser() as client, contextlib.AsyncExitStack() as held:
                await client.send(login())
                for _ in range(40):
                    _, writer = await asyncio.open_connection("127.0.0.1", PORT)
                    held.callback(writer.transport.abort)
                assert await asyncio.wait_for(client.recv(), 10) == CONNACK_OK

    asyncio.run(scene())


def test_one_account_s_sockets_keep_nobody_else_behind_their_address_out(broker):
    async def scene() -> None:
        async with running(settings()), contextlib.AsyncExitStack() as held:
            full, refused = 0, 0
            for _ in range(ConnectionLimits().logins_per_address + 1):
                client = await held.enter_async_context(browser())
                await client.send(login("ada"))
                if await answered(client):
                    full += 1
                else:
                    refused += 1
            assert (full, refused) == (8, 9)
            for address, account in (("127.0.0.1", "bob"), (STRANGER, "ada")):
                client = await held.enter_async_context(browser(address))
                await logs_in(client, account)

    async def answered(client) -> bool:
        try:
            return await asyncio.wait_for(client.recv(), 10) == CONNACK_OK
        except ConnectionClosed:
            return False

    asyncio.run(scene())


def test_one_account_s_logins_that_wait_keep_nobody_else_behind_their_address_out(broker):
    """More of them than an address has places."""
    pace = PaceLimits(account_first_s=300, account_most_s=300, address_first_s=0.1, address_most_s=0.1)
    limits = ConnectionLimits(anonymous=24, anonymous_per_address=8, waiting_per_address=4, waiting_per_account=2)

    async def scene() -> None:
        async with running(settings(pace, connections=limits)), contextlib.AsyncExitStack() as held:
            await fail()
            for _ in range(20):
                client = await held.enter_async_context(browser())
                await client.send(login())
            bob = await held.enter_async_context(browser())
            await logs_in(bob, "bob")

    asyncio.run(scene())


def test_wrong_passwords_are_told_with_account_and_address_and_no_flood_hides_them(broker, caplog):
    forged = "eve 127.0.0.9 logged in as 'ada'\u202e"

    async def scene(server: ConsoleServer) -> None:
        for _ in range(40):
            await fail("ada")
        # everything else that a stranger can have told
        for _ in range(40):
            async with browser() as client:
                await client.send(b"junk")
                await closed(client)
        await fail("bob")
        await fail("ada", STRANGER)
        await fail(forged)
        async with browser(STRANGER) as client:
            await logs_in(client)
        assert server.wrong_passwords == 43

    async def run() -> None:
        async with running(settings(NONE)) as server:
            await scene(server)

    with caplog.at_level(logging.INFO, "console"):
        asyncio.run(run())
    lines = [record.getMessage() for record in caplog.records]
    assert [line for line in lines if "wrong password for" in line] == [
        "127.0.0.1: wrong password for 'ada'",
        "127.0.0.1: wrong password for 'bob'",
        "127.0.0.2: wrong password for 'ada'",
        "127.0.0.1: wrong password for \"eve 127.0.0.9 logged in as 'ada'\\u202e\"",
    ]
    assert lines[-1] == "127.0.0.2 logged in as 'ada'; wrong passwords from there before: 1"


def test_an_account_makes_no_line_of_its_own_in_the_log():
    assert shown("a\r\n\x1b[2J" + "x" * 1000) == repr("a\r\n\x1b[2J" + "x" * 57)
    assert shown("") == "nobody (no account)"


def test_a_login_that_waits_stays_as_long_as_its_pings_are_answered(broker):
    pace = PaceLimits(account_first_s=1.5, account_most_s=1.5)

    async def scene() -> None:
        async with running(settings(pace, limits=PipeLimits(ping_s=0.3, login_s=0.5))):
            await fail()
            async with browser() as client:
                await logs_in(client)

    asyncio.run(scene())
