"""A tool file: no tool is accepted that drops its part at one missed reply, or whose grip and release do not say which is which."""

from __future__ import annotations

import pytest
import yaml
from processes import ROOT

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.tool import read_tool, tool_of

FILE = yaml.safe_load((ROOT / "config/tools/vacuum_frame.yaml").read_text())
BISTABLE = {
    "outputs": {"close": {"on_stop": "off"}, "open": {"on_stop": "off", "opens": True}},
    "grip": FILE["grip"] | {"set": {"open": False, "close": True}},
    "release": FILE["release"] | {"set": {"close": False, "open": True}},
}


def test_the_shipped_tool_and_a_bistable_one_are_accepted():
    assert read_tool(ROOT / "config/tools/vacuum_frame.yaml").tool.outputs["vacuum"].opens is False
    assert tool_of(FILE | BISTABLE, "file").outputs["open"].opens is True


@pytest.mark.parametrize(
    "changes, sentence",
    [
        ({"outputs": {"vacuum": {"on_stop": "off", "opens": False}}}, "one missed reply would drop the part"),
        ({"outputs": {"vacuum": {"on_stop": False, "opens": False}}}, "one missed reply would drop the part"),
        ({"outputs": {"vacuum": {"on_stop": "keep"}}}, "opens for at least one output"),
        ({"outputs": {"vacuum": {"on_stop": "keep", "opens": True}}}, "a grip that does not set vacuum"),
        ({"release": FILE["release"] | {"set": {"vacuum": True}}}, "a release that sets vacuum"),
        (BISTABLE | {"release": FILE["release"] | {"set": {"close": False}}}, "a release that sets open"),
        (BISTABLE | {"grip": FILE["grip"] | {"set": {"open": True, "close": True}}}, "a grip that does not set open"),
    ],
)
def test_what_opens_by_itself_or_contradicts_itself_is_refused(changes, sentence):
    with pytest.raises(ConfigurationError, match=sentence):
        tool_of(FILE | changes, "file")
