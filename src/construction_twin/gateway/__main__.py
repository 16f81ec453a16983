"""`python -m construction_twin.gateway`: the cell PC's program."""

import sys

try:
    from construction_twin.gateway.command_line import main
except ModuleNotFoundError as error:
    if not (error.name or "").startswith("paho"):
        raise
    # none is there, or one from before 2.0, as Debian's 1.6
    sys.exit(f"{error}: this needs paho-mqtt 2.2.0; in a venv: python3 -m pip install paho-mqtt==2.2.0")

if __name__ == "__main__":
    sys.exit(main())
