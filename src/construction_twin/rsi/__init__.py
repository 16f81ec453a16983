"""The RSI protocol alone: the Ethernet XML, the telegrams of both sides, and the UDP socket.

In: bytes from the network, values to send, the text of an Ethernet XML. Out: parsed telegrams, bytes of replies, the layout of
both directions, or a typed error. May import ``core``. Runs on the cell PC. The facts behind it: docs/rsi.md.
"""
