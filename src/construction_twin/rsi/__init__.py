"""The RSI protocol alone: the Ethernet XML, and the telegrams of both sides.

In: bytes from the network, values to send, the text of an Ethernet XML. Out: parsed telegrams, bytes of replies, the layout of
both directions, or a typed error. May import ``core`` and ``controller``. Runs on the cell PC. The facts behind it: docs/rsi.md.
"""
