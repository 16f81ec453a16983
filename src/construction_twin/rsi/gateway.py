"""Keeps `python -m construction_twin.rsi.gateway` working for one release; the program is `construction_twin.gateway`.

The one module that imports upwards, as the import contract names.
"""

import sys

from construction_twin.gateway.command_line import main

if __name__ == "__main__":
    sys.exit(main())
