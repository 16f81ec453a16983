"""What the tests of IFC files share."""

from __future__ import annotations

import pytest
from ifc_models import IfcModel

from construction_twin.extensions.work.building import BuildingModel
from construction_twin.extensions.work.ifc.reader import read_ifc
from construction_twin.extensions.work.ifc.reading import load, save


@pytest.fixture
def read(tmp_path):
    """Write a model, its text or its bytes, and read it again, through the file in which another process hands it over."""

    def write_and_read(model: IfcModel | str | bytes) -> BuildingModel:
        path = tmp_path / "model.ifc"
        if isinstance(model, IfcModel):
            model.save(path)
        else:
            path.write_bytes(model if isinstance(model, bytes) else model.encode("ascii"))
        found = read_ifc(path, 1 << 24)
        save(found, tmp_path / "model.json")
        return load(tmp_path / "model.json", found.file, found.digest)

    return write_and_read
