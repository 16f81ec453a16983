"""Logins through the console, with real sockets and a real broker: what a wrong password costs, who has a place, what is told."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator
from functools import partial

import pytest
from mqtt_packets import connect
from piped_console import CONNACK_OK, broker_with, browser_at, closed, login, serving

from construction_twin.console.pipe import BROKER_AWAY, BrokerAddress, PipeLimits
from construction_twin.console.server import ServerSettings

PORT, BROKER_PORT = 28470, 28471
STRANGER = "127.0.0.2"
running = partial(serving, port=PORT)
browser = partial(browser_at, PORT)


@pytest.fixture(scope="module")
def broker(tmp_path_factory) -> Iterator[None]:
    with broker_with(tmp_path_factory.mktemp("broker"), BROKER_PORT, "ada", "bob"):
        yield


def settings(wrong_s: float = 0.0) -> ServerSettings:
    return ServerSettings({}, None, BrokerAddress("127.0.0.1", BROKER_PORT), limits=PipeLimits(wrong_s=wrong_s))


async def fail(account: str = "ada", address: str = "127.0.0.1") -> None:
    """Log in with a wrong password, and see it refused."""
    async with browser(address) as client:
        await client.send(login(account, "guess"))
        assert (await asyncio.wait_for(client.recv(), 10))[3] == 5
        assert await closed(client) == (BROKER_AWAY, "the broker has refused the login")


async def logs_in(client, account: str = "ada") -> None:
    await client.send(login(account))
    assert await asyncio.wait_for(client.recv(), 10) == CONNACK_OK


def test_the_answer_to_a_wrong_password_comes_late_and_to_a_right_or_to_none_at_once(broker):
    async def scene() -> None:
        async with running(settings(0.5)):
            clock = asyncio.get_running_loop().time
            began = clock()
            await fail()
            assert clock() - began >= 0.5
        # whatever comes at all here has not waited
        async with running(settings(300.0)):
            async with browser() as client:
                await logs_in(client)
            async with browser() as first:
                await first.send(connect(version=5))
                assert (await asyncio.wait_for(first.recv(), 10))[3] == 0x87

    asyncio.run(scene())


def test_wrong_passwords_are_told_with_account_and_address_and_no_other_flood_hides_them(broker, caplog):
    forged = "eve 127.0.0.9 logged in as 'ada'\u202e"

    async def scene() -> None:
        async with running(settings()):
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

    with caplog.at_level(logging.INFO, "console"):
        asyncio.run(scene())
    lines = [record.getMessage() for record in caplog.records]
    assert [line for line in lines if "wrong password for" in line] == [
        "127.0.0.1: wrong password for 'bob'",
        "127.0.0.2: wrong password for 'ada'",
        "127.0.0.1: wrong password for \"eve 127.0.0.9 logged in as 'ada'\\u202e\"",
    ]
    assert lines[-1] == "127.0.0.2 logged in as 'ada'"
