"""The physics benchmark: a small run, for the names of its figures."""

from __future__ import annotations

import importlib
import json

import pytest
from physics_samples import ROOT


@pytest.fixture
def bench(monkeypatch):
    """The benchmark with short plans, few poses and no system beside it."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    module = importlib.import_module("physics")
    for name, value in (("SIMULATED", 0.2), ("PLANS", (1.0,)), ("POSES", 5)):
        monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(module, "live", lambda twin: {"rate_hz": 250.0, "jitter_ms_p99": 1.0, "cores": 0.1})
    return module


def test_its_figures_are_numbers_by_name(bench, tmp_path, monkeypatch, capsys):
    file = tmp_path / "physics.json"
    monkeypatch.setattr("sys.argv", ["physics.py", "--output", str(file)])
    bench.main()
    found = json.loads(file.read_text())
    assert found["real_time_factor"] > found["real_time_factor_awake"] > 0.0
    assert set(found["rehearsal_s"]) == set(found["settling_s"]) == {"1"}
    assert found["rehearsal_s"]["1"] > 0.0 and found["settling_s"]["1"] > 0.0
    assert set(found["rehearsal_wall_s"]) == {"motion", "settling"}
    assert set(found["live"]) == {"mujoco", "kinematic"}
    assert 0.0 <= found["gravity_rel_error"] < 1e-6 and found["inverse_dynamics_rel_rms"] < 0.01
    assert found["environment"]["packages"]["mujoco-core"].startswith("4.")
    assert "real_time_factor_awake" in capsys.readouterr().out
