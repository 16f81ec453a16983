"""Looks at the arguments of a launch before anything starts: what cannot work is one sentence, not a heap of dying nodes.

Standard library only. Called by bringup.launch as ``preflight name:=value ...``; ports are looked at by who opens them.
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
SWITCHES = ("auto_approve", "broker", "gateway", "commissioning", "tool_marker", "track", "gui", "separation")
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
OPTIONAL_FILES = ("scene", "bridge_account", "gateway_account")


def problem(given: Mapping[str, str], is_file: Callable[[str], bool]) -> str:
    """Return a sentence about the first argument that cannot work; empty when all can.

    Parameters
    ----------
    given : Mapping of str to str
        Launch arguments; those that are missing are not looked at.
    is_file : callable
        Returns whether a path is a file that can be read.
    """
    for name, value in given.items():
        expected = _expected(name, value, is_file)
        if expected:
            return f"{name}:={value or chr(39) * 2}: expected {expected}"
    if given.get("broker") == "true" and "broker_config" in given and not is_file(given["broker_config"]):
        return f"broker_config:={given['broker_config']}: expected the path of a file; or use another broker with broker:=false"
    listen = given.get("rsi_listen", "127.0.0.1")
    served_here = given.get("arm") != "none" and given.get("gateway", "true").lower() in ("true", "1")
    if served_here and not given.get("rsi_controller") and not is_loopback(listen):
        return f"rsi_controller:='': expected the controller's address, because rsi_listen:={listen} is reached from a network"
    return ""


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
    if (name in FILES or (name in OPTIONAL_FILES and value)) and not is_file(value):
        return "the absolute path of a file that can be read"
    return ""


def main(arguments: Sequence[str] | None = None) -> int:
    """Check ``name:=value`` arguments; print "ok", or a sentence on standard error and return 1."""
    words = sys.argv[1:] if arguments is None else arguments
    given = dict(word.split(":=", 1) for word in words if ":=" in word)
    sentence = problem(given, _readable)
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
