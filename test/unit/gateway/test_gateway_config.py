"""The gateway's configuration file and its hash."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import pytest
import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.gateway.config import GatewayConfig, load_config, parse_config
from construction_twin.robot.description import AxisMapping, read_robot_files
from construction_twin.ros.nodes.rsi_gateway import gateway_config
from construction_twin.rsi.ethernet_xml import EthernetXmlError

ROOT = Path(__file__).resolve().parents[3]
CONFIG = GatewayConfig("arm", ("A1", "A2"), (-3.0, -1.0), (3.0, 1.0), (2.0, 1.0), (2.5, 5.0))


def edited(change) -> str:
    document = json.loads(CONFIG.to_json())
    change(document)
    return json.dumps(document)


def test_a_written_file_reads_back_equal():
    config = dataclasses.replace(CONFIG, decimals=6, properties=False, reference="AIPos", lower=(-math.pi, -1 / 3))
    assert parse_config(config.to_json(), "file") == config


def test_the_hash_does_not_depend_on_the_files_layout():
    document = json.loads(CONFIG.to_json())
    document["motion"] = dict(reversed(document["motion"].items()))
    assert parse_config(json.dumps(document), "file").hash == CONFIG.hash


@pytest.mark.parametrize(
    "changes",
    [
        {"decimals": 4},
        {"upper": (3.0, 1.0000001)},
        {"robot": "other"},
        {"playout_delay": 0.021},
        {"acceleration": (2.5, 5.1)},
        {"e1_sign": -1},
        {"layout": dataclasses.replace(CONFIG.layout, sentype="Twin")},
        {"layout": dataclasses.replace(CONFIG.layout, port=49153)},
        {"layout": dataclasses.replace(CONFIG.layout, onlysend=True)},
    ],
)
def test_every_change_of_what_the_arm_may_do_changes_the_hash(changes):
    assert dataclasses.replace(CONFIG, **changes).hash != CONFIG.hash


@pytest.mark.parametrize(
    "changes, where",
    [
        ({"lower": (-3.0,)}, "lower"),
        ({"velocity": (2.0, math.inf)}, "velocity"),
        ({"lower": (3.0, -1.0)}, "lower"),
        ({"velocity": (0.0, 1.0)}, "velocity"),
        ({"decimals": 0}, "decimals"),
        ({"decimals": True}, "decimals"),
        ({"properties": "no"}, "properties"),
        ({"reference": "aspos"}, "reference"),
        ({"start_tolerance": 0}, "start_tolerance"),
        ({"playout_delay": 0.019}, "playout_delay"),
        ({"playout_delay_max": 0.5}, "playout_delay_max"),
        ({"silence": math.inf}, "silence"),
        ({"e1_sign": 0}, "e1_sign"),
        ({"e1_offset": math.nan}, "e1_offset"),
        ({"e1_feedback_scale": 0.0}, "e1_feedback_scale"),
        ({"linear": ("E1",)}, "linear"),
    ],
)
def test_values_without_meaning_are_refused_by_name(changes, where):
    with pytest.raises(ConfigurationError) as caught:
        dataclasses.replace(CONFIG, **changes)
    assert caught.value.where == where


def test_a_file_edited_by_hand_is_refused_and_says_so():
    text = edited(lambda document: document["motion"].update(velocity=[9.0, 9.0]))
    with pytest.raises(ConfigurationError, match="; the file was edited, export it again"):
        parse_config(text, "arm.json")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "3",
        '{"format": 3, "motion": []}',
        edited(lambda document: document.pop("hash")),
        edited(lambda document: document.update(format=1)),
        edited(lambda document: document["motion"].pop("timeout")),
        edited(lambda document: document["motion"].update(colour="orange")),
        edited(lambda document: document["motion"].update(layout=None)),
        edited(lambda document: document["motion"]["layout"].pop("port")),
    ],
)
def test_what_the_exporter_did_not_write_is_refused_with_the_files_name_or_its_key(text):
    with pytest.raises(ConfigurationError):
        parse_config(text, "arm.json")


# -- export from the robot -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def robot():
    return read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")


@pytest.fixture(scope="module")
def settings():
    return yaml.safe_load((ROOT / "config/gateway.yaml").read_text())


def test_the_shipped_settings_give_a_configuration_with_the_robots_limits(robot, settings, tmp_path):
    config = gateway_config(robot, settings | {"decimals": 3})
    path = tmp_path / "kr120.json"
    path.write_text(config.to_json())
    assert load_config(str(path)) == config
    assert config.axes == ("A1", "A2", "A3", "A4", "A5", "A6")
    assert (config.lower, config.upper) == (robot.lower, robot.upper)
    assert (config.velocity, config.acceleration) == (robot.velocity, robot.acceleration)


def test_sign_and_offset_turn_joint_ranges_into_axis_ranges(robot, settings):
    axes = (AxisMapping("A1", -1, 0.5), *robot.axes[1:])
    config = gateway_config(dataclasses.replace(robot, axes=axes), settings)
    assert config.lower[0] == pytest.approx(0.5 - robot.upper[0])
    assert config.upper[0] == pytest.approx(0.5 - robot.lower[0])
    assert config.lower[1:] == robot.lower[1:]


def test_timeout_is_counted_in_cycles_as_the_controller_does(robot, settings):
    assert gateway_config(robot, settings).timeout == 0.4
    assert gateway_config(robot, settings | {"cycle": 12}).timeout == 1.2
    assert gateway_config(robot, settings | {"cycle": 12, "timeout": 10}).timeout == 0.12


@pytest.mark.parametrize("cycle", [8, "4", 4.0, None])
def test_a_cycle_that_rsi_does_not_have_is_refused(robot, settings, cycle):
    with pytest.raises(ConfigurationError, match="cycle.*4 or 12 ms:"):
        gateway_config(robot, settings | {"cycle": cycle})


# -- the Ethernet XML --------------------------------------------------------------------------------------------------

FILE = (ROOT / "krl" / "ethernet" / "ctwin_ethernet.xml").read_text()


def test_the_ethernet_xml_is_in_the_file_and_in_the_hash(robot, settings, tmp_path):
    config = gateway_config(robot, settings | {"ethernet_xml": FILE})
    assert config.layout.receive == ("Stop", *(f"AK.{axis}" for axis in config.axes))
    path = tmp_path / "kr120.json"
    path.write_text(config.to_json())
    assert load_config(str(path)) == config
    assert config.hash != gateway_config(robot, settings).hash
    other = FILE.replace("192.168.1.10", "192.168.1.11").replace("<CONFIG>", "<CONFIG><!-- a comment -->")
    # where the PC is, is no property of the motion
    assert gateway_config(robot, settings | {"ethernet_xml": other}).hash == config.hash


def test_an_ethernet_xml_that_does_not_fit_the_robot_is_refused_when_it_is_exported(robot, settings):
    track = (ROOT / "krl" / "ethernet" / "ctwin_e1_ethernet.xml").read_text()
    with pytest.raises(EthernetXmlError, match="RECEIVE EK.E1: found 'E1', expected the robot's axes A1, A2"):
        gateway_config(robot, settings | {"ethernet_xml": track})


def test_a_linear_joint_is_exported_with_its_axis():
    track = read_robot_files(ROOT / "urdf" / "kr120_track.urdf.xacro", ROOT / "config" / "kr120_track.yaml")
    file = (ROOT / "krl" / "ethernet" / "ctwin_e1_ethernet.xml").read_text()
    config = gateway_config(
        track, yaml.safe_load((ROOT / "config" / "gateway.yaml").read_text()) | {"ethernet_xml": file}
    )
    assert config.axes[0] == "E1" and config.linear == ("E1",)
    assert config.limits.linear == (True, *(False,) * 6)
    assert config.start_tolerances == (config.start_tolerance_linear, *(config.start_tolerance,) * 6)
    assert parse_config(config.to_json(), "file") == config


@pytest.mark.parametrize("linear, upper", [(True, 100.0), (False, math.radians(1000.0))])
def test_a_range_that_the_joint_string_cannot_carry_is_refused(robot, settings, linear, upper):
    wide = dataclasses.replace(robot, linear=(linear, *robot.linear[1:]), upper=(upper, *robot.upper[1:]))
    with pytest.raises(ConfigurationError, match=r"upper limits of kr120.*a range the wire can carry \("):
        gateway_config(wide, settings)
