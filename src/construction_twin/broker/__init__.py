"""A site's MQTT broker: accounts, access rules, certificates, and the start of mosquitto.

In: names of hosts, robots and people. Out: mosquitto's files, account folders, and mosquitto itself. May import ``core`` and
``mqtt``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.broker.access import Site as Site
    from construction_twin.broker.access import SiteAccount as SiteAccount
    from construction_twin.broker.access import access_rules as access_rules
    from construction_twin.broker.access import broker_configuration as broker_configuration
    from construction_twin.broker.certificates import Authority as Authority
    from construction_twin.broker.console_files import ConsoleFiles as ConsoleFiles
    from construction_twin.broker.make_site import SiteFolder as SiteFolder
    from construction_twin.broker.start import listener_ports as listener_ports
    from construction_twin.broker.start import trial as trial
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
