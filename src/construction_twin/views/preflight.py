"""Checks the arguments of a launch by themselves: what cannot work, or must not be left to a default, is one sentence.

Standard library only. What is in the files, and what runs already, is looked at in `ros.commands.preflight`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from construction_twin.core.network import is_loopback

_BOOLEAN = "true or false"
#: Arguments with a few allowed values.
CHOICES = {
    "arm": ("mock", "real", "none"),
    "servo": ("ideal", "realistic"),
    "protocol": ("5", "3.1.1"),
    "gateway_kind": ("rsi", "plc"),
}
SWITCHES = (
    "auto_approve",
    "auto_approve_is_meant",
    "anonymous_broker_is_meant",
    "broker",
    "gateway",
    "commissioning",
    "tool_marker",
    "follow_joint_trajectory",
    "track",
    "gui",
    "separation",
    "mqtt_trajectories",
    "console",
    "console_files",
)
#: Whole numbers with their bounds.
NUMBERS = {
    "decimals": (1, 6),
    "broker_port": (1, 65535),
    "rsi_port": (0, 65535),
    "realtime": (0, 80),
    "frame_rate": (1, 250),
    "console_port": (1, 65535),
}
#: What stands for no file: roslaunch drops an empty value.
NONE = "none"
#: Files that are needed unless that is given, which is said of the first only: few controllers have no file.
WITHOUT = ("scene", "ethernet_xml")
#: Files that must be there, and those that may be left out.
FILES = ("robot_xacro", "robot_config", "self_collision", "ethernet_xml")
OPTIONAL_FILES = (
    "scene",
    "cell",
    "tool",
    "bridge_account",
    "gateway_account",
    "console_certificate",
    "console_key",
    "console_broker_ca",
)

#: Returns whether a path is a file that can be read, or has some other quality.
Question = Callable[[str], bool]


def problem(given: Mapping[str, str], is_file: Question, is_anonymous: Question = lambda path: False) -> str:
    """Return a sentence about the first argument that cannot work, or must be meant; empty when there is none.

    Args:
        given: Launch arguments; those that are missing are not checked.
        is_file: Returns whether a path is a file that can be read.
        is_anonymous: Returns whether the mosquitto configuration at a path lets in everybody.
    """
    return next(filter(None, (check(given, is_file, is_anonymous) for check in CHECKS)), "")


def _wrong_value(given: Mapping[str, str], is_file: Question, _is_anonymous: Question) -> str:
    for name, value in given.items():
        expected = _expected(name, value, is_file)
        if expected:
            return f"{name}:={value or chr(39) * 2}: expected {expected}"
    return ""


def _broker_without_file(given: Mapping[str, str], is_file: Question, _is_anonymous: Question) -> str:
    if is_true(given, "broker") and "broker_config" in given and not is_file(given["broker_config"]):
        return f"broker_config:={given['broker_config']}: expected the path of a file; or use another broker with broker:=false"
    return ""


def _open_rsi(given: Mapping[str, str], _is_file: Question, _is_anonymous: Question) -> str:
    listen = given.get("rsi_listen", "127.0.0.1")
    served_here = given.get("arm") != "none" and has_gateway_here(given)
    if served_here and not given.get("rsi_controller") and not is_loopback(listen):
        return f"rsi_controller:='': expected the controller's address, because rsi_listen:={listen} is reached from a network"
    return ""


def _nobody_approves(given: Mapping[str, str], _is_file: Question, _is_anonymous: Question) -> str:
    real = given.get("arm") == "real"
    if real and is_true(given, "auto_approve") and not is_true(given, "auto_approve_is_meant"):
        return (
            "auto_approve:=true with arm:=real: the arm would move without a person who has approved the plan; leave it out, or "
            "give auto_approve_is_meant:=true as well"
        )
    if real and given.get("auto_approve_sources"):
        return (
            f"auto_approve_sources:={given['auto_approve_sources']} with arm:=real: expected none, because the name of a "
            "client proves nothing, and the arm would move without a person who has approved the plan; leave it out"
        )
    return ""


def _anonymous_broker(given: Mapping[str, str], _is_file: Question, is_anonymous: Question) -> str:
    if given.get("arm") != "real" or is_true(given, "anonymous_broker_is_meant"):
        return ""
    anonymous = ""
    if not given.get("bridge_account"):
        anonymous = "bridge_account:=''"
    elif has_gateway_here(given) and not given.get("gateway_account"):
        anonymous = "gateway_account:=''"
    elif is_true(given, "broker") and is_anonymous(given.get("broker_config", "")):
        anonymous = f"broker_config:={given['broker_config']}"
    if anonymous:
        return (
            f"{anonymous} with arm:=real: the broker lets in everybody, and every client can command the arm; make a site with "
            "make_site and give its accounts and its broker_config, or give anonymous_broker_is_meant:=true"
        )
    return ""


def _mock_without_track(given: Mapping[str, str], _is_file: Question, _is_anonymous: Question) -> str:
    if is_bare(given) and given.get("arm") == "mock" and is_true(given, "track"):
        return (
            "track:=true with gateway_kind:=plc: the PLC of examples/plc, which is the mock arm then, has no track; give "
            "arm:=real"
        )
    return ""


def _console_to_nobody(given: Mapping[str, str], _is_file: Question, _is_anonymous: Question) -> str:
    if not is_true(given, "console"):
        return ""
    if given.get("arm") == "none":
        return (
            "console:=true with arm:=none: nothing is told by MQTT then, and the page would stay empty; give arm:=mock"
        )
    certificate, key = given.get("console_certificate", ""), given.get("console_key", "")
    if bool(certificate) != bool(key):
        missing = "console_key" if certificate else "console_certificate"
        return f"{missing}:='': expected a file, because certificate and key belong together; give both or neither"
    listen = given.get("console_listen", "127.0.0.1")
    if not certificate and not is_loopback(listen):
        return (
            f"console_listen:={listen}: expected loopback, or console_certificate and console_key: passwords cross the network; "
            "make_site makes a certificate"
        )
    host, has_ca = given.get("broker_host", "127.0.0.1"), bool(given.get("console_broker_ca"))
    if not has_ca and (given.get("bridge_account") or not is_loopback(host)):
        why = f"broker_host:={host}" if not is_loopback(host) else "bridge_account"
        return (
            f"console_broker_ca:='' with {why}: expected the ca.crt of the site, because a site's broker speaks TLS, and passwords "
            "cross the network"
        )
    return ""


#: What is checked of the arguments alone, in this order: each returns a sentence, empty when all is well.
CHECKS: tuple[Callable[[Mapping[str, str], Question, Question], str], ...] = (
    _wrong_value,
    _broker_without_file,
    _open_rsi,
    _nobody_approves,
    _anonymous_broker,
    _mock_without_track,
    _console_to_nobody,
)


def notes(given: Mapping[str, str]) -> list[str]:
    """Return what must be said of a start that can work, one sentence each."""
    if is_bare(given) and given.get("arm") == "real":
        return [
            "gateway_kind:=plc with arm:=real: a bare PLC is commanded by joint strings alone. Configuration, session, sequence "
            "and age of strings, stops and speed limits are not checked, on neither side; a person is responsible for that, by "
            "name: `rosrun construction_twin twin arm --responsible NAME`. Read docs/broker.md first"
        ]
    return []


def is_bare(given: Mapping[str, str]) -> bool:
    """Return whether a bare PLC takes the commands."""
    return given.get("gateway_kind") == "plc"


def has_gateway_here(given: Mapping[str, str]) -> bool:
    """Return whether rsi_gateway is started on this machine; with a bare PLC there is none."""
    return is_true(given, "gateway", "true") and not is_bare(given)


def is_true(given: Mapping[str, str], name: str, default: str = "false") -> bool:
    """Return whether a switch is on."""
    return given.get(name, default).lower() in ("true", "1")


def _expected(name: str, value: str, is_file: Callable[[str], bool]) -> str:
    """Return what an argument should have been; empty when it is that."""
    if name == "robot" and not re.fullmatch(r"[a-z][a-z0-9_]*", value):
        return "a name of small letters, digits and _, e.g. kr120"
    if name in CHOICES and value not in CHOICES[name]:
        *first, last = CHOICES[name]
        return f"{', '.join(first)} or {last}"
    if name in SWITCHES and value.lower() not in ("true", "false", "1", "0"):
        return _BOOLEAN
    if name in NUMBERS:
        lowest, highest = NUMBERS[name]
        if not (value.isascii() and value.isdigit() and lowest <= int(value) <= highest):
            return f"a whole number from {lowest} to {highest}"
    if name in WITHOUT and value == NONE:
        return ""
    if (name in FILES or (name in OPTIONAL_FILES and value)) and not is_file(value):
        return "the absolute path of a file that can be read" + (f", or {NONE}" if name == "scene" else "")
    return ""
