"""Who may command."""

from __future__ import annotations

from construction_twin.gateway.ownership import MEMORY, Ownership


def test_what_is_remembered_is_bounded():
    owners = Ownership()
    for k in range(MEMORY + 1):
        assert owners.begin(f"s{k}")
    assert not owners.knows("s0") and owners.knows("s1") and owners.knows(f"s{MEMORY}")
