"""How the arm's servos answer: their model, the file it is kept in, how it is identified, and how it is refined on line.

In: the targets that the controller took, one per cycle, and where the arm was measured. Out: where the servos should have the arm.
May import ``core``.
"""
