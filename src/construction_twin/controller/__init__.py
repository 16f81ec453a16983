"""The port to a robot controller: what gateway, mock and set-up ask of a make of controller, whatever its protocol.

In: what a make tells of itself. Out: telegrams as values, units of axes, a tool's signals, the last resort's braking, and a make by
its name. May import ``core``; a make's own folder imports this one. Runs on the cell PC.
"""
