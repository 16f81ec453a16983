"""The fixtures and hooks of all unit tests."""

from realtime import pytest_runtest_protocol
from unit_fixtures import broker, broker_process, topics

__all__ = ["broker", "broker_process", "pytest_runtest_protocol", "topics"]
