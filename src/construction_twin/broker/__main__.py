"""`python -m construction_twin.broker`: certificates, accounts and access rules of a site (`make_site`), without ROS."""

import sys

from construction_twin.broker.make_site import main

if __name__ == "__main__":
    sys.exit(main())
