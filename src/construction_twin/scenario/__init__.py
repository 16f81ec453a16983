"""Faults on demand and their judgement: definition, time line, checks and table.

In: a scenario file, a recording, the gateway's trace. Out: a verdict with checks and figures, and the table of
docs/scenarios.md. May import ``core``, ``gateway``, ``mock`` and ``evaluation``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.scenario.definition import Expectation as Expectation
    from construction_twin.scenario.definition import Injection as Injection
    from construction_twin.scenario.definition import Move as Move
    from construction_twin.scenario.definition import Scenario as Scenario
    from construction_twin.scenario.definition import Step as Step
    from construction_twin.scenario.definition import make_scenario as make_scenario
    from construction_twin.scenario.definition import read_scenario as read_scenario
    from construction_twin.scenario.judge import Check as Check
    from construction_twin.scenario.judge import Judgement as Judgement
    from construction_twin.scenario.table import markdown_table as markdown_table
    from construction_twin.scenario.table import print_verdict as print_verdict
    from construction_twin.scenario.table import read_verdicts as read_verdicts
    from construction_twin.scenario.timeline import Change as Change
    from construction_twin.scenario.timeline import GatewayStop as GatewayStop
    from construction_twin.scenario.timeline import Run as Run
    from construction_twin.scenario.timeline import SyncMoment as SyncMoment
    from construction_twin.scenario.trace_check import Excess as Excess
    from construction_twin.scenario.trace_check import trace_excesses as trace_excesses
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
