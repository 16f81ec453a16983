"""Units, errors, motion limits, files, real-time scheduling, network addresses and travel times; standard library only."""
