"""Where the tool goes while a plan is played, as it travels."""

from __future__ import annotations

import json

from construction_twin.extensions.console.remote_review import PathView

PATH = PathView("p1", [0.1 * k for k in range(11)], [(0.1 * k, 0.123456, 0.0) for k in range(11)])


def test_a_path_that_is_short_enough_goes_whole_and_rounded():
    said = json.loads(PATH.to_json(11))
    assert said["plan_id"] == "p1" and len(said["times"]) == len(said["tool_path"]) == 11
    assert said["tool_path"][10] == [1.0, 0.1235, 0.0] and said["times"][3] == 0.3


def test_a_thinned_path_keeps_its_ends_and_its_rests_each_with_its_time():
    said = json.loads(PATH.to_json(3, keep=(7,)))
    assert said["times"] == [0.0, 0.5, 0.7, 1.0]
    assert [point[0] for point in said["tool_path"]] == said["times"]
