"""The library behind the nodes: pure Python, in folders that import only from those below them.

The folders, what goes in and out of each, and the order that import-linter enforces: docs/architecture.md. Only ``ros``, and the
nodes and commands of the extensions, import rospy. ``core``, ``controller``, ``mqtt``, ``rsi`` and ``gateway`` need the standard
library and paho-mqtt only, so that they run on the cell PC.
"""

__version__ = "0.2.0"  # package.xml's
