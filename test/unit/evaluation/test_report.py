"""Figures of summary.json and table1.csv, what is printed, and the files of a report."""

from __future__ import annotations

import csv
import dataclasses
import io
import json

import numpy as np
import pytest
from evaluation_samples import JOINTS, link, run
from rich.console import Console

from construction_twin.evaluation import report, tables
from construction_twin.evaluation.alignment import evaluate
from construction_twin.evaluation.tables import summarise
from construction_twin.robot.description import read_robot_files

KEYS = [
    "waypoints", "samples", "duration_s", "decimals", "servo", "lag_s", "tables", "commands_sent", "commands_lost",
    "late_replies", "reply_us", "round_trip_ms", "rate_hz", "final_error_rad",
]  # fmt: skip
MOCK = {
    "state": "running",
    "correction_lower_deg": [-185.0],
    "counters": {},
    "config": {"servo": "ideal", "timeout": 100, "correction_lower_deg": []},
}


def printed(summary) -> str:
    console = Console(file=io.StringIO(), width=80, highlight=False)
    tables.render_tables(summary, console)
    return console.file.getvalue()


@pytest.fixture(scope="module")
def full_summary():
    links = [
        link(0.1, 100),
        link(0.9, 300, lost=1, counts=(10, 0, 0, 0)),
        link(5.0, 1300, lost=2, late=1, counts=(900, 90, 0, 0)),
        link(11.5, 2900, lost=3, late=4, counts=(999, 3, 1, 0)),
        link(12.5, 3300, lost=3, late=5, counts=(1010, 990, 9, 1)),
    ]
    return summarise(evaluate(run(links=links, mock=MOCK)))


def test_summary_has_the_promised_keys_in_their_order(full_summary):
    assert list(full_summary)[: len(KEYS)] == KEYS
    json.dumps(full_summary, allow_nan=False)


def test_summary_of_a_known_run(full_summary):
    assert full_summary["waypoints"] == 200
    assert full_summary["duration_s"] == pytest.approx(10.0)
    assert full_summary["samples"] == pytest.approx(2510, abs=2)
    assert full_summary["lag_s"] == pytest.approx(0.012, abs=1e-9)
    assert full_summary["servo"] == "ideal" and full_summary["decimals"] == 3
    assert full_summary["mock"] == {"servo": "ideal", "timeout": 100, "correction_lower_deg": [-185.0]}
    assert full_summary["round_trip_ms"] == pytest.approx({"p50": 23.0, "p99": 23.0, "p99_9": 23.0, "max": 23.0})
    assert full_summary["rate_hz"] == pytest.approx({"twin": 250.0, "physical": 250.0, "command": 250.0})
    assert max(full_summary["final_error_rad"].values()) == 0.0


def test_counters_are_differences_between_the_reports_around_the_window(full_summary):
    assert full_summary["commands_sent"] == 3300 - 300
    assert full_summary["commands_lost"] == 3 - 1
    assert full_summary["late_replies"] == 5


def test_reply_times_are_bin_edges_of_the_windows_own_replies(full_summary):
    # 1000 x <= 50, 990 x <= 100, 9 x <= 200 and one beyond: p99.9 of 2000 is the 1998th
    assert full_summary["reply_us"] == {"p50": 50, "p99": 100, "p99_9": 200, "max": 431.5}


def test_what_the_recording_does_not_tell_is_null():
    summary = summarise(evaluate(run(plans=False, feedback=False)))
    for key in ("waypoints", "decimals", "servo", "lag_s", "commands_sent", "commands_lost", "late_replies", "mock"):
        assert summary[key] is None
    assert summary["tables"]["by_command"] is None and summary["tables"]["lag_removed"] is None
    assert set(summary["tables"]["instant"]) == set(JOINTS)
    nothing = {"p50": None, "p99": None, "p99_9": None, "max": None}
    assert summary["reply_us"] == nothing and summary["round_trip_ms"] == nothing


def test_counts_across_two_sessions_or_a_restarted_gateway_are_null():
    links = [link(0.5, 500, lost=7, counts=(5, 0, 0, 0)), link(12.5, 900, lost=2, session="s2")]
    summary = summarise(evaluate(run(links=links)))
    assert summary["commands_sent"] is None and summary["commands_lost"] is None
    assert summary["reply_us"]["p50"] is None


def test_csv_has_a_row_per_alignment_and_joint_beside_the_papers(full_summary):
    rows = list(csv.DictReader(io.StringIO(tables.table_csv(full_summary["tables"]))))
    assert [(r["alignment"], r["joint"]) for r in rows] == [(a, j) for a in tables.ALIGNMENTS for j in JOINTS]
    row = rows[2]
    assert float(row["avg_rad"]) == full_summary["tables"]["by_command"]["joint_a3"]["avg_rad"]
    assert float(row["paper_max_rad"]) == 2.0717e-05
    assert float(row["max_ratio"]) == pytest.approx(float(row["max_rad"]) / 2.0717e-05)


def test_printed_tables_follow_the_figures(full_summary):
    text = printed(full_summary)
    assert all(f"{name}: " in text for name in tables.ALIGNMENTS)
    assert f"{full_summary['tables']['instant']['joint_a6']['max_rad']:.4e}" in text
    assert "…" not in text, "a narrow terminal cuts figures off"
    assert "2.2334e-05" in text and "A3 and A6" in text
    assert "12.000000 ms" in text and "This is a simulation" in text
    assert "round trip [ms]: p50 23.000" in text and "RSI reply time [us]: p50 50" in text


def test_every_summary_says_whether_the_arm_was_simulated_or_that_the_recording_does_not(full_summary):
    without = summarise(evaluate(run()))
    assert tables.remarks(full_summary) == [tables.SIMULATION]
    assert tables.remarks(without) == [tables.ARM_UNKNOWN]
    assert tables.ARM_UNKNOWN in printed(without).replace("\n", " ")


def test_figures_of_a_recording_in_which_nothing_moved_are_said_to_be_none_of_a_motion(full_summary):
    still = run(plans=False)
    rest = np.zeros_like(still.twin.positions)
    still = dataclasses.replace(
        still,
        twin=dataclasses.replace(still.twin, positions=rest),
        physical=dataclasses.replace(still.physical, positions=np.zeros_like(still.physical.positions)),
        mock=MOCK,
    )
    summary = summarise(evaluate(still))
    assert summary["moved"] is False and full_summary["moved"] is True
    assert tables.remarks(summary) == [tables.NO_MOTION, tables.SIMULATION]


def test_report_writes_every_file(tmp_path):
    robot = read_robot_files("urdf/kr120r2500.urdf.xacro", "config/kr120.yaml")
    links = [link(0.5, 1), link(12.5, 2, counts=(30, 20, 5, 1))]
    written = report.write_report(run(links=links), robot, tmp_path / "results" / "now")
    names = ["figure8.png", "figure9.png", "report.html", "summary.json", "table1.csv"]
    assert [path.name for path in written.files] == names
    assert json.loads((tmp_path / "results/now/summary.json").read_text()) == written.summary
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in written.files if path.suffix == ".png")
    assert written.summary["environment"]["cpus"] >= 1
