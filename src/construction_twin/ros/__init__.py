"""The ROS side of the core: nodes, commands, messages, transport.

In: topics, services, parameters. Out: the same, from what the library returns. Nodes stay thin: convert, call, convert,
publish. Its own order is transport, messages, shared, nodes, commands; it may import every other folder of the core.
"""
