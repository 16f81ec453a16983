"""A seeded, short run of `make fuzz`."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def fuzz():
    """scripts/fuzz.py; it finds the modules of test/fuzz itself."""
    path = list(sys.path)
    spec = importlib.util.spec_from_file_location("fuzz", ROOT / "scripts" / "fuzz.py")
    module = sys.modules["fuzz"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    del sys.modules["fuzz"]
    sys.path[:] = path


def test_codecs_and_running_gateway_stand_up_to_a_short_run(fuzz, capsys):
    assert fuzz.main(["--count", "2000", "--seed", "3"]) == 0, capsys.readouterr().out
    said = capsys.readouterr().out
    assert "nothing crashed, nothing moved, everything was counted, memory stayed flat" in said
    # all four, and in each the refusals that its mutations are made for
    for campaign in ("MQTT codecs", "RSI codecs", "MQTT, running gateway", "RSI, running gateway"):
        assert f"{campaign:22}      2000 sent" in said
    expected = "properties control format length status refused_session refused_control refused_properties refused_verb"
    expected += " stop pause resume joints values"
    expected += " refused_retained refused_not_armed telegram_refused_xml telegram_refused_ipoc telegram_refused_source telegrams"
    assert [name for name in expected.split() if f"    {name} " not in said] == []
