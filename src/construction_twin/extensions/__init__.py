"""What the core does not need: work from a building model, physics, the console, other planners.

Each folder is pure but for its `nodes` and `commands`, and imports the core; the core finds it by its name (`core/extensions.py`).
"""
