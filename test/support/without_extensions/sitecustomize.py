"""Python imports this at each start if its folder is on PYTHONPATH: then there are no extensions, as where none was installed."""

import sys

sys.modules["construction_twin.extensions"] = None  # type: ignore[assignment]
