"""Work from a building model: which element the arm places when, from where, in which grip, and what has been built so far.

In: a building model read from IFC, a cell file, tool and recipe files, the scene, the ledger of what was done. Out: checked
segments of a work plan, or why a task cannot be done; the state of every task. Only ``ifc`` knows ifcopenshell.
May import the core and ``physics``.
"""
