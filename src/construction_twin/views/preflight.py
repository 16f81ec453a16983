"""Checks the arguments of a launch before anything starts: what cannot work, or must not be left to a default, is one sentence.

Standard library only. Called by bringup.launch as ``preflight name:=value ...``. A port that is taken is reported by the program
that opens it.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from construction_twin.core.network import is_loopback

_BOOLEAN = "true or false"
#: Arguments with a few allowed values.
CHOICES = {
    "arm": ("mock", "real", "none"),
    "servo": ("ideal", "realistic"),
    "protocol": ("5", "3.1.1"),
}
SWITCHES = (
    "auto_approve",
    "auto_approve_is_meant",
    "anonymous_broker_is_meant",
    "broker",
    "gateway",
    "commissioning",
    "tool_marker",
    "track",
    "gui",
    "separation",
)
#: Whole numbers with their bounds.
NUMBERS = {
    "decimals": (1, 6),
    "broker_port": (1, 65535),
    "rsi_port": (0, 65535),
    "realtime": (0, 80),
    "frame_rate": (1, 250),
}
#: Files that must be there, and those that may be left out.
FILES = ("robot_xacro", "robot_config", "self_collision", "ethernet_xml")
#: What stands for no file: roslaunch drops an empty value.
NONE = "none"
OPTIONAL_FILES = ("scene", "bridge_account", "gateway_account")


def problem(
    given: Mapping[str, str],
    is_file: Callable[[str], bool],
    is_anonymous: Callable[[str], bool] = lambda path: False,
) -> str:
    """Return a sentence about the first argument that cannot work, or must be meant; empty when there is none.

    Parameters
    ----------
    given : Mapping of str to str
        Launch arguments; those that are missing are not checked.
    is_file : callable
        Returns whether a path is a file that can be read.
    is_anonymous : callable, optional
        Returns whether the mosquitto configuration at a path lets in everybody.
    """
    for name, value in given.items():
        expected = _expected(name, value, is_file)
        if expected:
            return f"{name}:={value or chr(39) * 2}: expected {expected}"
    if _is_true(given, "broker") and "broker_config" in given and not is_file(given["broker_config"]):
        return f"broker_config:={given['broker_config']}: expected the path of a file; or use another broker with broker:=false"
    listen = given.get("rsi_listen", "127.0.0.1")
    served_here = given.get("arm") != "none" and _is_true(given, "gateway", "true")
    if served_here and not given.get("rsi_controller") and not is_loopback(listen):
        return f"rsi_controller:='': expected the controller's address, because rsi_listen:={listen} is reached from a network"
    return _unsafe(given, is_anonymous) if given.get("arm") == "real" else ""


def _unsafe(given: Mapping[str, str], is_anonymous: Callable[[str], bool]) -> str:
    """Return why a real arm must not be started like this; empty when it may."""
    if _is_true(given, "auto_approve") and not _is_true(given, "auto_approve_is_meant"):
        return (
            "auto_approve:=true with arm:=real: the arm would move without a person who has approved the plan; leave it out, or "
            "give auto_approve_is_meant:=true as well"
        )
    if _is_true(given, "anonymous_broker_is_meant"):
        return ""
    anonymous = ""
    if not given.get("bridge_account"):
        anonymous = "bridge_account:=''"
    elif _is_true(given, "gateway", "true") and not given.get("gateway_account"):
        anonymous = "gateway_account:=''"
    elif _is_true(given, "broker") and is_anonymous(given.get("broker_config", "")):
        anonymous = f"broker_config:={given['broker_config']}"
    if anonymous:
        return (
            f"{anonymous} with arm:=real: the broker lets in everybody, and every client can command the arm; make a site with "
            "make_site and give its accounts and its broker_config, or give anonymous_broker_is_meant:=true"
        )
    return ""


def _is_true(given: Mapping[str, str], name: str, default: str = "false") -> bool:
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
    if name == "scene" and value == NONE:
        return ""
    if (name in FILES or (name in OPTIONAL_FILES and value)) and not is_file(value):
        return "the absolute path of a file that can be read" + (f", or {NONE}" if name == "scene" else "")
    return ""


def main(arguments: Sequence[str] | None = None) -> int:
    """Check ``name:=value`` arguments; print "ok", or a sentence on standard error and return 1."""
    words = sys.argv[1:] if arguments is None else arguments
    given = dict(word.split(":=", 1) for word in words if ":=" in word)
    sentence = problem(given, _readable, _lets_in_everybody)
    if sentence:
        print(f"preflight: {sentence}", file=sys.stderr)
        return 1
    print("ok")
    return 0


def _readable(path: str) -> bool:
    if not path.startswith("/"):
        return False
    try:
        with Path(path).open("rb"):
            return True
    except OSError:
        return False


def _lets_in_everybody(path: str) -> bool:
    """Return whether a mosquitto configuration permits clients without an account; one that cannot be read is taken to."""
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return True
    # of several lines the last one counts; without one mosquitto 2 refuses clients without an account
    permitted = [line.split()[1:] for line in lines if line.split()[:1] == ["allow_anonymous"]]
    return bool(permitted) and permitted[-1] == ["true"]
