"""`python -m construction_twin.mock`: the mock KR C4, without ROS."""

import sys

from construction_twin.mock.program import main

if __name__ == "__main__":
    sys.exit(main())
