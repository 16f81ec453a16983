"""Tests use public names only and build objects by their constructors: what they reach into, nobody can change without them."""

from __future__ import annotations

import ast
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
#: Without this file, whose examples are what it looks for.
TESTS = sorted(path for path in (ROOT / "test").rglob("*.py") if path != Path(__file__))
#: How a name is reached that stands in a string.
BY_STRING = {"setattr", "getattr", "delattr", "hasattr", "object", "setitem"}

GENPY = "genpy's generated classes and rospy's messages offer it under this name only"
#: What a test may reach into, and why. An entry that is not needed any more is an error.
EXEMPT: dict[str, dict[str, str]] = {
    "test/unit/mqtt/test_fast_client.py": dict.fromkeys(
        (
            "_handle_publish", "_in_packet", "_out_packet", "_pack_remaining_length", "_server", "_sock", "_sock_send",
        ),
        "fast_client replaces these parts of paho; the test proves that the installed paho has them and what they do",
    ),
    "test/unit/broker/test_trial.py": {
        "_program": "injection: a mosquitto that does not end when it is asked to",
    },
    "test/unit/evaluation/test_evaluation_bag.py": {
        "_md5sum": GENPY,
    },
    "test/unit/gateway/test_gateway_failure.py": dict.fromkeys(
        (
            "_controller", "_encoder", "_inbox", "_mqtt", "_player", "_playout", "_selector", "_states",
            "_status", "_intake",
        ),
        "injection: an exception that nobody foresaw is put into each part of a running gateway, and a part has no other handle",
    ),
    "test/unit/gateway/test_slew_room.py": dict.fromkeys(
        ("_playout", "_choose_delay", "_slew", "_slew_limit"),
        "injection: playout time is moved by amounts and at paces that no network would bring about in a test",
    ),
    "test/unit/gateway/test_gateway_program.py": {
        "_try_connect": "injection into the gateway's thread that connects to the broker",
    },
    "test/unit/gateway/test_gateway_modes.py": {
        "_player": "mutated telegrams move the origin: replies, which count from it, do not tell where the arm is commanded to",
    },
    "test/support/moveit_messages.py": {"_md5sum": GENPY},
    "test/unit/ros/test_loaded_process.py": {
        "_exit": "Python's own way out of a forked process; its name is documented",
    },
    "test/unit/ros/test_executor_node.py": {"_connection_header": GENPY},
    "test/unit/ros/test_build_session.py": {
        "_newest": "what a session has heard is put there: its subscribers connect to a master",
    },
    "test/unit/ros/test_frame_listener.py": {
        "_connection_header": GENPY,
        **dict.fromkeys(
            ("_OWNERS", "_KEPT", "_look_at", "_owners", "_kept"),
            "the bounds of what is kept are set low, and what is kept is counted: it shows nowhere else",
        ),
    },
    "test/unit/ros/test_goal_server.py": {"_connection_header": GENPY},
    "test/unit/ros/test_planner_node.py": {"_connection_header": GENPY},
    "test/unit/ros/test_twin_cli.py": {"_client": "injection: what answers in place of the services of a running robot"},
    "test/unit/ros/test_marker_server.py": {"_connection_header": GENPY},
    "test/unit/ros/test_speed_limits.py": {"_connection_header": GENPY},
    "test/unit/ros/test_safety_acts.py": {"_connection_header": GENPY},
    "test/unit/ros/test_joint_goals.py": {"_full_text": GENPY, "_md5sum": GENPY, "_type": GENPY},
    "test/unit/ros/test_persistent_service.py": {
        "_md5sum": GENPY,
        "_type": GENPY,
        "_is_use_tcp_keepalive": "rospy asks the master for this before a connection; there is no master in the test",
    },
    "test/unit/ros/test_pose_message.py": {"_connection_header": GENPY, "_md5sum": GENPY, "_type": GENPY},
    "test/unit/ros/test_node.py": dict.fromkeys(
        (
            "__new__", "_SubscriberImpl", "_end", "_handle_request", "_invoke_callback", "_subscriber",
            "_write_service_error",
        ),
        "injection into rospy's own classes, whose constructors connect to a master: what they do on an error is what is tested",
    ),
}  # fmt: skip


def is_private(name: str) -> bool:
    return name.startswith("_") and not (name.startswith("__") and name.endswith("__"))


def is_own(node: ast.expr) -> bool:
    """Return whether an expression is the object, or the class, whose method is being written."""
    return ast.unparse(node) in ("self", "cls", "super()", "type(self)")


def script(text: str) -> str:
    """Return a text that is a program, as tests hand it to another interpreter; empty for any other."""
    source = textwrap.dedent(text)
    try:
        ast.parse(source)
    except SyntaxError:
        return ""
    return source


def reached(source: str) -> list[tuple[int, str]]:
    """Return line and name of every private name of others that a source uses, and of every object made past its constructor."""
    found: list[tuple[int, str]] = []
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Attribute) and not is_own(node.value):
            names = [node.attr] if is_private(node.attr) or node.attr == "__new__" else []
        elif isinstance(node, ast.ImportFrom):
            names = [alias.name for alias in node.names if is_private(alias.name)]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in BY_STRING:
            texts = [each.value for each in node.args[1:2] if isinstance(each, ast.Constant)]
            own = bool(node.args) and is_own(node.args[0])
            names = [text for text in texts if isinstance(text, str) and is_private(text) and not own]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "\n" in node.value:
            names = [name for _, name in reached(script(node.value))]
        found += [(node.lineno, name) for name in names]
    return sorted(found)


@pytest.mark.parametrize("path", TESTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_test_reaches_into_nothing(path):
    exempt = EXEMPT.get(str(path.relative_to(ROOT)), {})
    found = reached(path.read_text())
    assert [f"{path.name}:{line}: {name}" for line, name in found if name not in exempt] == []
    assert set(exempt) == {name for _, name in found}, "exemptions that nothing needs"


def test_every_exemption_has_a_file_and_a_reason():
    assert set(EXEMPT) <= {str(path.relative_to(ROOT)) for path in TESTS} and len(TESTS) > 200
    assert all(len(reason.split()) > 5 for names in EXEMPT.values() for reason in names.values())


def test_what_is_private_is_found():
    assert reached("a.b._c = d._e()") == [(1, "_c"), (1, "_e")]
    assert reached("object.__new__(A)\nA.__new__(A)") == [(1, "__new__"), (2, "__new__")]
    assert reached("from a import b, _c") == [(1, "_c")]
    assert reached("monkeypatch.setattr(a, '_b', 1)\ngetattr(a, '_b')") == [(1, "_b"), (2, "_b")]
    assert reached("mock.patch.object(a.b, '_c')") == [(1, "_c")]
    assert reached("self._a.b, cls._c, super()._d(), type(self)._e, a.__class__, _f(), a['_g'], a.get('_h')") == []
    assert reached('a = """\n    b._c\n    d\n"""') == [(1, "_c")]
    assert reached('a = """\n what b._c says,\n in words"""') == []
    assert reached("self._a._b") == [(1, "_b")]
