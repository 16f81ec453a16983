"""The list of recorded runs."""

from __future__ import annotations

import json
import os

from construction_twin.console.recordings import listing, recordings


def make_run(folder, name, stamp):
    """A run with a report of this time [s since 1970]."""
    (folder / name).mkdir(parents=True)
    report = folder / name / "report.html"
    report.write_text(name)
    os.utime(report, (stamp, stamp))


def test_runs_are_listed_the_newest_first_and_once_each_whatever_link_leads_to_them(tmp_path):
    results = tmp_path / "results"
    make_run(results, "older", 1000)
    make_run(results, "newer", 2000)
    (results / "latest").symlink_to("newer")
    runs = json.loads(listing(results))["runs"]
    assert [(run["name"], run["stamp"], run["report"]) for run in runs] == [
        ("newer", 2000.0, "newer/report.html"),
        ("older", 1000.0, "older/report.html"),
    ]


def test_a_run_that_can_be_played_says_so(tmp_path):
    make_run(tmp_path, "old", 1000)
    make_run(tmp_path, "new", 2000)
    (tmp_path / "new/replay.json").write_text("{}")
    runs = json.loads(listing(tmp_path))["runs"]
    assert [(run["name"], run["replay"]) for run in runs] == [("new", "new/replay.json"), ("old", "")]
    assert "new/replay.json" in recordings(tmp_path)


def test_a_link_out_of_the_folder_is_not_served(tmp_path):
    results = tmp_path / "results"
    make_run(results, "run", 1000)
    make_run(tmp_path / "elsewhere", "secret", 2000)
    (results / "link").symlink_to(tmp_path / "elsewhere" / "secret")
    assert list(recordings(results)) == ["run/report.html"]
