"""Units, errors, motion limits, files, real-time scheduling, network addresses and travel times.

Standard library only, because the cell PC has nothing else.
"""
