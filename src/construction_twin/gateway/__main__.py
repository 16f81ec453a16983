"""`python -m construction_twin.gateway`: the cell PC's program."""

import sys

from construction_twin.gateway.command_line import main

if __name__ == "__main__":
    sys.exit(main())
