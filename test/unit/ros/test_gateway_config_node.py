"""rsi_gateway under roslaunch: the files that it hands over to the gateway."""

from __future__ import annotations

from construction_twin.gateway.stop_file import StopFile
from construction_twin.ros.nodes.rsi_gateway import MOCK, NEW_MOCK, stop_file


def test_a_real_arm_s_stop_outlasts_a_simulation_and_another_master(tmp_path):
    """Law 5: nobody has reset it, and it is the same arm."""
    config, other = tmp_path / "http_a_11311_kr120_rsi_gateway.json", tmp_path / "http_b_11312_kr120_rsi_gateway.json"

    def found(arm, file=config):
        return StopFile(stop_file(arm, file, "kr120")).found

    def stop(arm):
        stops = StopFile(stop_file(arm, config, "kr120"))
        stops.save(f"{arm} stopped")
        stops.close()

    stop("real")
    assert found(NEW_MOCK) == ""
    stop(MOCK)
    assert found(MOCK) == "mock stopped" and found("real") == "real stopped"
    assert found(NEW_MOCK) == "" and found("real", other) == "real stopped"
