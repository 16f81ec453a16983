"""IFC files: the only modules that import ifcopenshell, which is installed with `setup/setup.sh work`.

In: an IFC file. Out: the records of `extensions.work.building`, or one sentence that says what is wrong. A file is read in a
process of its own, within bounded memory and time; `reading.read_building` is for everybody. May import ``core``, ``kinematics``,
``scene`` and the modules of ``work`` itself.
"""
