"""The MQTT link: client, joint string, JSON messages, accounts, and what a failed connection means.

In: joint positions with session, sequence number and stamp; payloads from the broker. Out: payloads and their parsed contents,
or a typed error for each malformed one. May import ``core`` and paho-mqtt. Runs on the cell PC.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.mqtt.account import Account as Account
    from construction_twin.mqtt.account import load_account as load_account
    from construction_twin.mqtt.client import Broker as Broker
    from construction_twin.mqtt.client import make_client as make_client
    from construction_twin.mqtt.failures import ConnectionReport as ConnectionReport
    from construction_twin.mqtt.fast_client import DirectClient as DirectClient
    from construction_twin.mqtt.fast_client import FastClient as FastClient
    from construction_twin.mqtt.interventions import Intervention as Intervention
    from construction_twin.mqtt.interventions import parse_intervention as parse_intervention
    from construction_twin.mqtt.joint_string import JointStringCodec as JointStringCodec
    from construction_twin.mqtt.messages import CommandProperties as CommandProperties
    from construction_twin.mqtt.messages import Control as Control
    from construction_twin.mqtt.messages import StateProperties as StateProperties
    from construction_twin.mqtt.messages import Topics as Topics
    from construction_twin.mqtt.messages import parse_control as parse_control
    from construction_twin.mqtt.messages import parse_object as parse_object
    from construction_twin.mqtt.messages import parse_presence as parse_presence
    from construction_twin.mqtt.messages import parse_status as parse_status
    from construction_twin.mqtt.messages import read_command_properties as read_command_properties
    from construction_twin.mqtt.messages import read_state_properties as read_state_properties
    from construction_twin.mqtt.plain_client import PlainClient as PlainClient
    from construction_twin.mqtt.polled_client import PolledClient as PolledClient
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
