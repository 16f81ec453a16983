"""Planning loads no plotting library, and whoever draws beside it gets the real one."""

import subprocess
import sys

import pytest

LOADED = "import sys; {}; assert not [name for name in sys.modules if name.startswith('matplotlib')], 'loaded'"


@pytest.mark.parametrize("module", ["planning.pipeline", "ros.nodes.planner"])
def test_what_plans_loads_no_plotting_library(module):
    code = LOADED.format(f"import construction_twin.{module}")
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60.0)


def test_drawing_works_after_planning_and_before_it():
    drawing = "from matplotlib.backends.backend_agg import FigureCanvasAgg; import matplotlib.pyplot as p; p.Figure()"
    planning = "import construction_twin.planning.timing"
    for code in (f"{planning}; {drawing}", f"{drawing}; {planning}"):
        subprocess.run([sys.executable, "-c", code], check=True, timeout=60.0)
