"""The RSI protocol alone: the Ethernet XML, and the telegrams of both sides.

In: bytes from the network, values to send, the text of an Ethernet XML. Out: parsed telegrams, bytes of replies, the layout of
both directions, or a typed error. May import ``core`` and ``controller``. Runs on the cell PC. The facts behind it: docs/rsi.md.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.rsi.controller_codec import RobotEncoder as RobotEncoder
    from construction_twin.rsi.controller_codec import SensorDecoder as SensorDecoder
    from construction_twin.rsi.controller_codec import parse_sensor as parse_sensor
    from construction_twin.rsi.ethernet_xml import EthernetXml as EthernetXml
    from construction_twin.rsi.ethernet_xml import check_axes as check_axes
    from construction_twin.rsi.ethernet_xml import check_gateway as check_gateway
    from construction_twin.rsi.ethernet_xml import controller_sends_to as controller_sends_to
    from construction_twin.rsi.ethernet_xml import load_ethernet_xml as load_ethernet_xml
    from construction_twin.rsi.ethernet_xml import read_ethernet_xml as read_ethernet_xml
    from construction_twin.rsi.ethernet_xml_error import EthernetXmlError as EthernetXmlError
    from construction_twin.rsi.gateway_codec import RobotDecoder as RobotDecoder
    from construction_twin.rsi.gateway_codec import SensorEncoder as SensorEncoder
    from construction_twin.rsi.gateway_codec import parse_robot as parse_robot
    from construction_twin.rsi.layout import RsiLayout as RsiLayout
    from construction_twin.rsi.status_channels import RsiStatus as RsiStatus
    from construction_twin.rsi.status_channels import StatusReader as StatusReader
    from construction_twin.rsi.tool_channels import ToolReader as ToolReader
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
