# r: compas_fab==2.0.1, compas_eve==2.4.0
"""Component "connect": the connection to one robot.

In:  folder (text), host (text), port (whole number), robot (text), prefix (text, or empty for twin),
     account (text: path of account.json; empty: a broker without accounts), on (true or false)
Out: twin (the connection, for the other components), text (one line)
"""

import sys

if folder not in sys.path:  # noqa: F821
    sys.path.append(folder)  # noqa: F821

from twin_grasshopper import TwinProblem, connection, disconnect

twin, text = None, "off"
where = host, int(port), robot, prefix or "twin", account or ""  # noqa: F821
try:
    if on:  # noqa: F821
        twin = connection(*where)
        text = (
            "connected"
            if twin.is_connected
            else "not let in yet: the broker is not there, or does not know this account"
        )
    else:
        disconnect(*where)
except TwinProblem as problem:
    text = str(problem)
