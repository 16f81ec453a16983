"""The cell PC's program between MQTT and a robot controller: the last line before the controller.

In: commands and control messages by MQTT, one telegram every cycle. Out: one reply per telegram, the measured state and
the gateway's status by MQTT. May import ``core``, ``controller``, ``mqtt`` and paho-mqtt. Runs on the cell PC without ROS.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.gateway.config import GatewayConfig as GatewayConfig
    from construction_twin.gateway.config import load_config as load_config
    from construction_twin.gateway.config import parse_config as parse_config
    from construction_twin.gateway.gateway import Answer as Answer
    from construction_twin.gateway.gateway import Gateway as Gateway
    from construction_twin.gateway.playout import Playout as Playout
    from construction_twin.gateway.service import GatewayService as GatewayService
    from construction_twin.gateway.states import Event as Event
    from construction_twin.gateway.states import Mode as Mode
    from construction_twin.gateway.states import State as State
    from construction_twin.gateway.trace import TraceEntry as TraceEntry
    from construction_twin.gateway.trace import TraceWriter as TraceWriter
    from construction_twin.gateway.trace import read_trace as read_trace
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
