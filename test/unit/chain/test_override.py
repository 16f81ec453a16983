"""A plan while the controller reports an override of 30 %, which does not act on corrections (docs/rsi.md): nothing holds it."""

from __future__ import annotations

from chain_samples import REACH, ROOT, assert_corrections_inside_limits, make_chain, make_plan, play_to_the_end

from construction_twin.mock.faults import Fault
from construction_twin.monitor.states import SyncState

#: The shipped file, with the channel that a person adds in RSIVisual.
ETHERNET = (ROOT / "krl/ethernet/ctwin_ethernet.xml").read_text()
TOLD = ETHERNET.replace(
    "    </ELEMENTS>\n  </SEND>", '      <ELEMENT TAG="OvPro" TYPE="LONG" INDX="1"/>\n    </ELEMENTS>\n  </SEND>'
)


def played(override: float):
    """A chain after a plan that ran at an override [%], and how the gate's state changed meanwhile."""
    chain = make_chain(3, ethernet_xml=TOLD)
    chain.faults.inject(Fault("override", values=(override,)))
    chain.run_for(0.1)
    assert chain.controller.status_shown.override == override
    began = len(chain.transitions)
    play_to_the_end(chain, make_plan(chain, REACH))
    return chain, chain.transitions[began:]


def test_a_plan_at_an_override_of_30_percent_is_played_without_a_hold_and_as_at_100():
    chain, transitions = played(30.0)
    assert transitions == []
    assert chain.gate.state is SyncState.IN_SYNC
    assert_corrections_inside_limits(chain)
    full, _ = played(100.0)
    assert [position for _, position in chain.measured] == [position for _, position in full.measured]
