"""The console's program: static pages over HTTP, and a pipe from WebSocket to the broker's TCP port.

In: requests of browsers, a folder of files, the broker's address. Out: files with their hashes, MQTT bytes in both directions,
unchanged. It has no rights of its own: who may do what is the broker's decision alone. May import ``core``.
"""
