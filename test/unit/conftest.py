"""The fixtures of all unit tests."""

from unit_fixtures import broker, broker_process, topics

__all__ = ["broker", "broker_process", "topics"]
