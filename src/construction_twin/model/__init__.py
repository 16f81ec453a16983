"""The robot's looks and masses: parametric solids, their meshes as COLLADA files, and inertias from the solids."""
