"""What several nodes need, and parts of large nodes.

Parameters, diagnostics, the MQTT connection, the gateway's configuration, listeners, the operator's client.

In: a node's parameters and topics. Out: checked settings, counters on ``/diagnostics``, the latest reports of a robot. May
import the library, ``ros.transport`` and ``ros.messages``.
"""
