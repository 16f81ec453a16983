"""Who may command."""

from __future__ import annotations

from construction_twin.gateway.ownership import MEMORY, Ownership
from construction_twin.mqtt.messages import Control


def test_a_session_has_its_turn_once():
    owners = Ownership()
    assert [owners.begin(name) for name in ("a", "b", "a", "b", "c")] == [True, True, False, False, True]
    assert owners.knows("a") and not owners.knows("d")


def test_a_control_message_counts_once_and_every_part_of_it_tells_it_apart():
    owners = Ownership()
    first = Control("1", "s1", "arm", "hash")
    assert not owners.is_repeated(first)
    assert owners.is_repeated(first) and owners.is_repeated(Control("1", "s1", "arm", "another value"))
    for other in (Control("2", "s1", "arm"), Control("1", "s2", "arm"), Control("1", "s1", "reset")):
        assert not owners.is_repeated(other)


def test_what_is_remembered_is_bounded():
    owners = Ownership()
    for k in range(MEMORY + 1):
        assert owners.begin(f"s{k}")
    assert not owners.knows("s0") and owners.knows("s1") and owners.knows(f"s{MEMORY}")


def test_the_last_intruder_and_their_number_are_kept():
    owners = Ownership()
    assert (owners.intruder, owners.intrusions) == ("", 0)
    for name in ("x", "x", "y"):
        owners.refuse(name)
    assert (owners.intruder, owners.intrusions) == ("y", 3)
