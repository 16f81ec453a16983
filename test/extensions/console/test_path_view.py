"""Where the tool goes while a plan is played, as it travels."""

from __future__ import annotations

import json

from construction_twin.extensions.console.remote_review import PathView

PATH = PathView("p1", [0.1 * k for k in range(11)], [(0.1 * k, 0.123456, 0.0) for k in range(11)])


def test_a_thinned_path_keeps_its_ends_and_its_rests_each_with_its_time():
    said = json.loads(PATH.to_json(3, required=(7,)))
    assert said["times"] == [0.0, 0.5, 0.7, 1.0]
    assert [point[0] for point in said["tool_path"]] == said["times"]
