"""Units, errors, motion limits, files, real-time scheduling, network addresses and travel times.

In: numbers, stamps and texts from any other folder. Out: converted values, typed errors, motion checks, bounded motion of one
joint (``follower``), cubic interpolation, state machines as a table and its runner (``state_table``), limits on how often
(``rate_limit``), where the package's files are (``share``). May import the standard library
only, because the cell PC has nothing else.
"""
