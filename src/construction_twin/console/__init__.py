"""The console's program: static pages over HTTP, and a pipe from WebSocket to the broker's TCP port.

In: requests of browsers, a folder of files, one of paired devices, the broker's address. Out: files with their hashes, MQTT bytes
in both directions, unchanged but for a paired device's password. It has no rights of its own: who may do what is the broker's
decision alone. May import ``core``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.console.connection_limits import ConnectionLimits as ConnectionLimits
    from construction_twin.console.pipe import BrokerAddress as BrokerAddress
    from construction_twin.console.pipe import PipeLimits as PipeLimits
    from construction_twin.console.server import ConsoleServer as ConsoleServer
    from construction_twin.console.server import ServerSettings as ServerSettings
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
