"""The gate's settings: what a person may write, and in which ranges."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.monitor.settings import GateSettings

FILE = Path(__file__).resolve().parents[3] / "config/pca_monitor.yaml"
BEHAVIOUR = GateSettings.model_validate(
    {name: value for name, value in yaml.safe_load(FILE.read_text()).items() if name in GateSettings.model_fields}
)


@pytest.mark.parametrize(
    "name, largest",
    [
        ("threshold", 1.0), ("threshold_linear", 1.0), ("lag_allowance", 1.0), ("lag_margin", 1.0), ("feedback_timeout", 10.0),
        ("agree_share", 1.0), ("agree_time", 60.0), ("give_up_time", 3600.0), ("escalate_count", 1000), ("escalate_time", 3600.0),
    ],
)  # fmt: skip
class TestNumbers:
    def test_have_a_largest_value(self, name, largest):
        assert getattr(BEHAVIOUR.with_changes(f"{{{name}: {largest}}}"), name) == largest
        with pytest.raises(ConfigurationError, match=name):
            BEHAVIOUR.with_changes(f"{{{name}: {largest + 1}}}")

    @pytest.mark.parametrize(
        "value", ["yes", '"0.5"', ".nan", ".inf", "-1", "null", "[1]", "{a: 1}", "2001-01-01", 400 * "9"]
    )
    def test_are_numbers(self, name, largest, value):
        with pytest.raises(ConfigurationError, match=name):
            BEHAVIOUR.with_changes(f"{{{name}: {value}}}")

    def test_may_be_whole(self, name, largest):
        assert getattr(BEHAVIOUR.with_changes(f"{{{name}: 1}}"), name) == 1


@pytest.mark.parametrize("value", ["1.01", "yes", '"0.5"', "0"])
def test_the_threshold_of_a_single_joint_has_the_same_range(value):
    assert BEHAVIOUR.with_changes("{thresholds: {joint_a1: 1}}").thresholds == {"joint_a1": 1.0}
    with pytest.raises(ConfigurationError, match="joint_a1"):
        BEHAVIOUR.with_changes(f"{{thresholds: {{joint_a1: {value}}}}}")


@pytest.mark.parametrize(
    "text",
    ["{policy: 2001-99-99}", 3000 * "[", 3000 * "{a: ", "{policy", "{1: 2}", "{[1]: 2}", "&a {policy: *a}", "\0"],
)
def test_a_text_that_cannot_be_read_is_refused_with_one_sentence(text):
    with pytest.raises(ConfigurationError) as refusal:
        BEHAVIOUR.with_changes(text)
    assert len(str(refusal.value)) < 1000
