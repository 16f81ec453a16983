"""The port to a robot controller: what gateway, mock and set-up ask of a make of controller, whatever its protocol.

In: what a make tells of itself. Out: telegrams as values, units of axes, a tool's signals, the last resort's braking, and a make by
its name. May import ``core``; a make's own folder imports this one. Runs on the cell PC.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.controller.axis_unit import AxisUnit as AxisUnit
    from construction_twin.controller.last_resort import BareProtocol as BareProtocol
    from construction_twin.controller.last_resort import LastResort as LastResort
    from construction_twin.controller.makes import make_of as make_of
    from construction_twin.controller.port import Make as Make
    from construction_twin.controller.port import Reader as Reader
    from construction_twin.controller.port import Words as Words
    from construction_twin.controller.telegram import Reply as Reply
    from construction_twin.controller.telegram import Telegram as Telegram
    from construction_twin.controller.telegram import stamp_step as stamp_step
    from construction_twin.controller.tool import GatewayTool as GatewayTool
    from construction_twin.controller.tool import ToolOutput as ToolOutput
    from construction_twin.controller.tool import ToolReading as ToolReading
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
