"""Fixtures that the unit tests of core and extensions share."""

from __future__ import annotations

import itertools
import os

import hypothesis
import pytest
from processes import BrokerProcess

from construction_twin.mqtt.messages import Topics

# how long an example takes is the machine's affair, not the product's; and a red run is red again until it is mended, a green one
# stays green: new examples are looked for by `make test ARGS=properties`
hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True)
hypothesis.settings.register_profile("random", deadline=None)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


_prefixes = (f"test{number}" for number in itertools.count())


@pytest.fixture
def broker_process():
    """A started BrokerProcess that the test may kill and start again."""
    process = BrokerProcess()
    process.start()
    yield process
    process.kill()


@pytest.fixture(scope="module")
def broker():
    """Port of a broker that a module's tests share; use a topic prefix of your own."""
    process = BrokerProcess()
    process.start()
    yield process.port
    process.kill()


@pytest.fixture
def topics():
    """MQTT topics that no other test uses."""
    return Topics(next(_prefixes), "arm")
