"""What several nodes need: parameters, diagnostics, the MQTT connection, listeners, the operator's client.

In: a node's parameters and topics. Out: checked settings, counters on ``/diagnostics``, the latest reports of a robot. May
import the library, ``ros.transport`` and ``ros.messages``.
"""
