"""What catkin and pip both read: version, modules and shared files. All other metadata is in pyproject.toml.

Both run this file with the repository as their working folder.
"""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

#: Folders whose files are installed below ``share/construction_twin``, where `construction_twin.core.share` finds them.
SHARED = ("config", "krl", "models", "msg", "urdf")

files = [
    Path("package.xml"),
    *(file for folder in SHARED for file in sorted(Path(folder).rglob("*")) if file.is_file()),
]
setup(
    version=ElementTree.parse("package.xml").findtext("version"),
    packages=find_packages("src"),
    package_dir={"": "src"},
    package_data={"construction_twin": ["py.typed"]},
    data_files=[(f"share/construction_twin/{file.parent}", [str(file)]) for file in files],
)
