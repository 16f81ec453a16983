"""How the arm's servos answer: their model, and the file it is kept in (identified in physics, refined on line by the monitor).

In: the targets that the controller took, one per cycle. Out: where the servos should have the arm. May import ``core``.
"""
