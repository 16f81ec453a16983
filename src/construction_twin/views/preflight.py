"""Checks the arguments of a launch by themselves: what cannot work, or must not be left to a default, is one sentence.

Standard library only. What is in the files, and what runs already, is looked at in `ros.commands.preflight`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

from construction_twin.core.network import is_loopback
from construction_twin.core.sentences import Sentence

#: Arguments with a few allowed values.
CHOICES = {
    "arm": ("mock", "real", "none"),
    "twin": ("kinematic", "mujoco", "gazebo"),
    "servo": ("ideal", "realistic", "physics"),
    "protocol": ("5", "3.1.1"),
    "gateway_kind": ("rsi", "plc"),
    "rehearsal": ("auto", "advise", "require", "off"),
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
    "console",
    "console_files",
)
#: Whole numbers with their bounds.
NUMBERS = {
    "decimals": (1, 6),
    "broker_port": (1, 65535),
    "rsi_port": (0, 65535),
    "realtime": (0, 80),
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
    "drives",
    "servo_model",
    "bridge_account",
    "gateway_account",
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
            return Sentence("preflight.wrong", name=name, value=value or "''", expected=expected)
    return ""


def _broker_without_file(given: Mapping[str, str], is_file: Question, _is_anonymous: Question) -> str:
    if is_true(given, "broker") and "broker_config" in given and not is_file(given["broker_config"]):
        return Sentence("preflight.broker_config", path=given["broker_config"])
    return ""


def _open_rsi(given: Mapping[str, str], _is_file: Question, _is_anonymous: Question) -> str:
    listen = given.get("rsi_listen", "127.0.0.1")
    served_here = given.get("arm") != "none" and has_gateway_here(given)
    if served_here and not given.get("rsi_controller") and not is_loopback(listen):
        return Sentence("preflight.rsi_controller", listen=listen)
    return ""


def _nobody_approves(given: Mapping[str, str], _is_file: Question, _is_anonymous: Question) -> str:
    real = given.get("arm") == "real"
    if real and is_true(given, "auto_approve") and not is_true(given, "auto_approve_is_meant"):
        return Sentence("preflight.auto_approve")
    if real and given.get("auto_approve_sources"):
        return Sentence("preflight.auto_approve_sources", sources=given["auto_approve_sources"])
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
    return Sentence("preflight.anonymous", anonymous=anonymous) if anonymous else ""


def _mock_without_track(given: Mapping[str, str], _is_file: Question, _is_anonymous: Question) -> str:
    if is_bare(given) and given.get("arm") == "mock" and is_true(given, "track"):
        return Sentence("preflight.track")
    return ""


def _console_to_nobody(given: Mapping[str, str], _is_file: Question, _is_anonymous: Question) -> str:
    if not is_true(given, "console"):
        return ""
    if given.get("arm") == "none":
        return Sentence("preflight.console_arm")
    if given.get("console_site"):
        return ""
    listen, host = given.get("console_listen", "127.0.0.1"), given.get("broker_host", "127.0.0.1")
    if not is_loopback(listen):
        return Sentence("preflight.console_site", why=f"console_listen:={listen}")
    if not is_loopback(host):
        return Sentence("preflight.console_site", why=f"broker_host:={host}")
    return Sentence("preflight.console_site", why="bridge_account") if given.get("bridge_account") else ""


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
        return [Sentence("preflight.bare")]
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
        return Sentence("preflight.expected.robot")
    if name in CHOICES and value not in CHOICES[name]:
        return one_of(CHOICES[name])
    if name in SWITCHES and value.lower() not in ("true", "false", "1", "0"):
        return one_of(("true", "false"))
    if name in NUMBERS:
        lowest, highest = NUMBERS[name]
        if not (value.isascii() and value.isdigit() and lowest <= int(value) <= highest):
            return Sentence("preflight.expected.number", lowest=lowest, highest=highest)
    if name in WITHOUT and value == NONE:
        return ""
    if (name in FILES or (name in OPTIONAL_FILES and value)) and not is_file(value):
        may_be_none = name == "scene"
        return (
            Sentence("preflight.expected.file_or_none", none=NONE)
            if may_be_none
            else Sentence("preflight.expected.file")
        )
    return ""


def one_of(words: Sequence[str]) -> str:
    """Return the words that an argument can have, as what was expected."""
    *first, last = words
    return Sentence("preflight.expected.one_of", first=", ".join(first), last=last) if first else last
