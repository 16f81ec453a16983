"""What a person sees in terminal and rviz: command line, dashboard, start-up report, ghosts, colours and texts.

In: records of the other folders, arguments of a command line. Out: texts, pictures in the terminal, marker records, requests.
Draws and asks, but never decides what may move. May import ``core``, ``robot``, ``kinematics``, ``scene``, ``review``,
``monitor`` and ``link``.
"""
