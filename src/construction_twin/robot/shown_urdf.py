"""A URDF as a browser shows it: visual shapes only, each mesh by the SHA-256 of its file, so that it is fetched once and kept."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import read_file
from construction_twin.core.sentences import Sentence
from construction_twin.robot.packages import Packages

#: Largest mesh file [bytes].
_LARGEST = 64 * 2**20
#: What a browser's loaders read.
SUFFIXES = (".stl", ".dae", ".obj")


@dataclass(frozen=True)
class ShownUrdf:
    """What a browser gets.

    Attributes:
        text: The URDF; its meshes are ``<folder><digest><suffix>``.
        meshes: Contents by ``<digest><suffix>``.
        problems: One sentence for each shape that is left out, because its mesh cannot be used.
    """

    text: str
    meshes: dict[str, bytes] = field(default_factory=dict)
    problems: tuple[str, ...] = ()


def shown_urdf(urdf: str, folder: str) -> ShownUrdf:
    """Return a URDF without collision shapes, whose visual meshes are named by their digests.

    Args:
        urdf: Expanded.
        folder: What stands before a mesh's name, e.g. ``/private/mesh/``.

    Raises:
        ElementTree.ParseError: If the text is not XML.
    """
    # bytes, because the XML parser refuses an encoding declaration in a str
    robot = ElementTree.fromstring(urdf.encode())
    packages, meshes, problems = Packages(), {}, []
    for link in robot.iter("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is None:
                continue
            try:
                path = packages.file(mesh.get("filename", ""), f"URDF link {link.get('name')} visual mesh")
                name, contents = _read(path)
            except ConfigurationError as error:
                problems.append(str(error))
                link.remove(visual)
                continue
            meshes[name] = contents
            mesh.set("filename", folder + name)
    return ShownUrdf(ElementTree.tostring(robot, encoding="unicode"), meshes, tuple(problems))


def _read(path: Path) -> tuple[str, bytes]:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ConfigurationError(
            str(path), f"a mesh that ends in {suffix!r}", Sentence("expected.one_of", known=", ".join(SUFFIXES))
        )
    try:
        contents = read_file(path, _LARGEST)
    except OSError as error:
        raise ConfigurationError(str(path), error.strerror, Sentence("expected.robot.mesh_file")) from error
    return hashlib.sha256(contents).hexdigest() + suffix, contents
