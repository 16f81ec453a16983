"""`work register`: the base in the model from points known in both, the cell file, and what is refused with its cause."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.extensions.work.building import PlacementError
from construction_twin.extensions.work.commands.work_register import main, read_points, register
from construction_twin.extensions.work.work_cell import pose_of, read_work_cell
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import rpy_to_rotation

ROOT = Path(__file__).resolve().parents[3]
#: In base_link [m]: what an arm reaches, on no plane.
POINTS = np.array([[2.0, 0.0, 0.1], [1.2, 1.5, 0.4], [-0.5, 2.1, 1.6], [0.3, -1.9, 0.9]])
NAMES = ["P1", "P2", "P3", "P4"]
STANDS = Pose(np.array([12.345, -6.789, 0.512]), rpy_to_rotation((0.4, -0.3, 37.0)))


def in_model(points: np.ndarray, pose: Pose = STANDS) -> np.ndarray:
    return points @ pose.rotation.T + pose.position


def written(folder: Path, base: np.ndarray, model: np.ndarray, form: str = "metres") -> Path:
    lines = ["name,base_x,base_y,base_z,model_x,model_y,model_z"]
    rows = [(name, *one, *other) for name, one, other in zip(NAMES, base, model)]
    if form == "millimetres":
        lines = ["name,base_x_mm,base_y_mm,base_z_mm,model_x,model_y,model_z"]
        rows = [(name, *(1e3 * one), *other) for name, one, other in zip(NAMES, base, model)]
    lines += [f"{row[0]}," + ",".join(f"{value:.6f}" for value in row[1:]) for row in rows]
    if form == "german":
        lines = [line.replace(",", ";").replace(".", ",") for line in lines]
    file = folder / "points.csv"
    file.write_text("\n".join(lines), encoding="utf-8-sig")
    return file


@pytest.fixture
def cell(tmp_path) -> Path:
    shutil.copytree(ROOT / "config", tmp_path / "config")
    return tmp_path / "config" / "work" / "timber_panel.yaml"


@given(
    st.tuples(*[st.floats(-1e4, 1e4)] * 3),
    st.tuples(st.floats(-180, 180), st.floats(-89, 89), st.floats(-180, 180)),
    st.integers(3, 4),
    st.integers(0, 1000),
)
def test_any_pose_is_found_from_three_points_or_more_within_their_noise_also_10_km_away(xyz, rpy_deg, count, seed):
    pose = Pose(np.array(xyz), rpy_to_rotation(rpy_deg))
    noise = np.random.default_rng(seed).uniform(-1e-3, 1e-3, (count, 3))
    found = register(NAMES[:count], POINTS[:count], in_model(POINTS[:count], pose) + noise, 5e-3)
    assert max(found.residuals.values()) < 2e-3
    reached = in_model(POINTS, found.model_T_base)
    assert np.abs(reached - in_model(POINTS, pose)).max() < 8e-3


@pytest.mark.parametrize("form", ["metres", "millimetres", "german"])
def test_a_file_of_points_writes_the_base_into_the_cell_and_nothing_else(cell, tmp_path, capsys, form):
    before = cell.read_text(encoding="utf-8").splitlines()
    assert main([str(cell), str(written(tmp_path, POINTS, in_model(POINTS), form))]) == 0
    assert "P1: 0.00 mm" in capsys.readouterr().out
    pose = pose_of(read_work_cell(cell).file.model_T_base)
    assert np.abs(in_model(POINTS, pose) - in_model(POINTS)).max() < 5e-6
    after = cell.read_text(encoding="utf-8").splitlines()
    changed = [(one, other) for one, other in zip(before, after) if one != other]
    assert len(before) == len(after) and len(changed) == 1
    assert (
        changed[0][1].startswith("model_T_base: {xyz: [12.345")
        and "from points.csv, residuals P1 0.00" in changed[0][1]
    )
    # once more: the remark is the newest one's alone
    assert main([str(cell), str(written(tmp_path, POINTS, in_model(POINTS)))]) == 0
    assert cell.read_text(encoding="utf-8").count("# registered") == 1


def test_a_base_in_lines_of_its_own_is_replaced(cell, tmp_path):
    text = cell.read_text(encoding="utf-8")
    line = next(line for line in text.splitlines() if line.startswith("model_T_base"))
    instead = "model_T_base:\n  xyz: [1.0, 2.0, 3.0]\n  rpy_deg:\n    - 0\n    - 0\n    - 90 # by hand"
    cell.write_text(text.replace(line, f"{instead}\n# the next key"), encoding="utf-8")
    assert main([str(cell), str(written(tmp_path, POINTS, in_model(POINTS)))]) == 0
    assert "\n  xyz" not in cell.read_text(encoding="utf-8") and "# the next key" in cell.read_text(encoding="utf-8")


def test_a_point_may_be_the_origin_of_an_element_of_the_model(cell, tmp_path):
    from construction_twin.extensions.work.ifc.reading import read_building

    model = ROOT / "models" / "timber_panel.ifc"
    building = read_building(model)
    elements = [one for one in building.elements.values() if one.name][:5]
    origins = np.array([one.model_T_element.position for one in elements])
    back = (origins - STANDS.position) @ STANDS.rotation
    lines = ["name,base_x,base_y,base_z,model"]
    lines += [f"P{n},{x},{y},{z},{one.id}" for n, (one, (x, y, z)) in enumerate(zip(elements, back))]
    file = tmp_path / "touched.csv"
    file.write_text("\n".join(lines))
    assert main([str(cell), str(file), "--model", str(model)]) == 0
    assert np.allclose(pose_of(read_work_cell(cell).file.model_T_base).position, STANDS.position, atol=1e-5)


LINE = np.linspace(0.0, 1.0, 4)[:, None] * [1.0, 2.0, 0.5]


@pytest.mark.parametrize(
    "base, model, cause",
    [
        (POINTS[:2], in_model(POINTS[:2]), "2 points; expected three or more"),
        (LINE, in_model(LINE), "on a line within 0 mm"),
        (POINTS, in_model(POINTS * [1.0, -1.0, 1.0]), "a changed sign"),
        (POINTS, 1e3 * in_model(POINTS), "their units"),
        (POINTS, in_model(POINTS) + [[0, 0, 0], [0, 0.05, 0], [0, 0, 0], [0, 0, 0]], "P2 is .* mm off, 5.0 mm allowed"),
        (POINTS, in_model(np.roll(POINTS, 1, axis=0)), "exchanged points"),
    ],
)  # fmt: skip
def test_points_that_do_not_fit_are_refused(base, model, cause):
    with pytest.raises(PlacementError, match=cause):
        register(NAMES[: len(base)], base, model, 5e-3)


def test_a_refused_file_leaves_the_cell_as_it_is(cell, tmp_path, capsys):
    before = cell.read_bytes()
    flat = POINTS * [1.0, 1.0, 0.0]
    upside_down = written(tmp_path, flat, in_model(flat * [1.0, -1.0, 1.0], Pose(np.zeros(3), np.eye(3))))
    assert main([str(cell), str(upside_down)]) == 2
    assert "upside down" in capsys.readouterr().err
    assert main([str(cell), str(upside_down), "--hanging"]) == 0
    cell.write_bytes(before)
    for text, problem in (
        ("name,base_x,base_y,base_z,model\nP1,1,2,3,stud", "name its IFC file by --model"),
        ("name,base_x,base_y,base_z,model_x,model_y,model_z\nP1,1,2,,4,5,6", "line 2, base_z: found ''"),
        ("name,base_x,base_y,base_z,model_x,model_y,model_z\nP1,1,2,nan,4,5,6", "line 2, base_z: found 'nan'"),
        ("name,base_x\nP1,1\nP1,2", "base_y: found nothing"),
        ("", "0 points"),
    ):
        upside_down.write_text(text)
        assert main([str(cell), str(upside_down)]) == 2
        assert problem in capsys.readouterr().err
    assert cell.read_bytes() == before


def test_a_name_twice_is_refused(tmp_path):
    file = tmp_path / "twice.csv"
    file.write_text("name,base_x,base_y,base_z,model_x,model_y,model_z\nP1,1,2,3,4,5,6\nP1,1,2,3,4,5,6")
    with pytest.raises(Exception, match="a name of its own"):
        read_points(file, lambda name: np.zeros(3))
