"""IFC files: the only modules that import ifcopenshell, which is installed with `setup/setup.sh work`.

In: an IFC file. Out: the records of `work.building`, or one sentence that says what is wrong. A file is read in a process of its
own (`child`), within bounded memory and time; `reading.read_building` is for everybody. May import ``core``, ``kinematics`` and the
modules of ``work`` itself.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.work.ifc.reading import Bounds as Bounds
    from construction_twin.work.ifc.reading import read_building as read_building
    from construction_twin.work.ifc.schedule_writer import write_schedule as write_schedule
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
