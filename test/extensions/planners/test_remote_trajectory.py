"""`trajectory` on MQTT: what is read of a motion that was planned elsewhere, and that nothing is guessed."""

from __future__ import annotations

import copy
import json
import math

import pydantic
import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.errors import PayloadError
from construction_twin.extensions.planners.remote_trajectory import (
    TrajectoryMessage,
    TrajectoryPoint,
    TrajectoryRequest,
    parse_trajectory,
)
from construction_twin.link.requests import LARGEST, Joints, read_document

JOINTS = Joints(("track", "joint_a1", "joint_a2"), (True, False, False))
LIMIT = 100_000
UNITS = {"angle": "rad", "length": "m", "time": "s"}
PLAIN = {
    "id": "facade 7",
    "source": "Ada, facade",
    "units": UNITS,
    "joint_names": ["joint_a2", "track", "joint_a1"],
    "points": [
        {"positions": [2.0, 0.5, 1.0], "velocities": [0.0, 0.0, 0.0], "accelerations": [0.0, 0.0, 0.0], "time_from_start": 0},
        {
            "positions": [2.5, 1.5, -1.0],
            "velocities": [0.2, 0.1, 0.3], "accelerations": [-0.2, -0.1, -0.3], "time_from_start": 1.25,
        },
    ],
}  # fmt: skip


def plain(**changes) -> dict:
    return {key: value for key, value in (copy.deepcopy(PLAIN) | changes).items() if value is not ...}


def read(document, joints: Joints = JOINTS, limit: int = LIMIT) -> TrajectoryRequest:
    payload = document if isinstance(document, bytes) else json.dumps(document).encode()
    return parse_trajectory(read_document(payload, False, "trajectory", limit), joints)


def refusal(document) -> tuple[str, str]:
    with pytest.raises(PayloadError) as caught:
        read(document)
    # for an answer and a log line
    assert len(str(caught.value)) < 600
    return caught.value.reason, str(caught.value)


def test_joints_in_any_order_are_put_into_the_robot_s():
    request = read(plain())
    assert (request.id, request.source, request.speed_scale) == ("facade 7", "Ada, facade", 0.0)
    assert request.points == (
        TrajectoryPoint((0.5, 1.0, 2.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0),
        TrajectoryPoint((1.5, -1.0, 2.5), (0.1, 0.3, 0.2), (-0.1, -0.3, -0.2), 1_250_000_000),
    )


def test_degrees_and_millimetres_are_converted_where_they_are_said():
    point = {"positions": [90.0, 500.0, -180.0], "velocities": [9.0, 50.0, 18.0]}
    points = [point, point | {"time_from_start": 1}]
    request = read(plain(units={"angle": "deg", "length": "mm", "time": "s"}, points=points))
    assert request.points[0].positions == pytest.approx((0.5, -math.pi, math.pi / 2))
    assert request.points[1].velocities == pytest.approx((0.05, math.pi / 10, math.pi / 20))


@given(
    st.sampled_from(["rad", "deg"]),
    st.sampled_from(["m", "mm"]),
    st.lists(st.floats(-1000.0, 1000.0), min_size=3, max_size=3),
    st.permutations(range(3)),
)
def test_the_same_motion_in_other_units_and_another_order_is_the_same(angle, length, values, order):
    factors = {"rad": 1.0, "deg": 180.0 / math.pi, "m": 1.0, "mm": 1000.0}
    said = [value * factors[length if linear else angle] for value, linear in zip(values, JOINTS.linear)]
    document = plain(
        units={"angle": angle, "length": length, "time": "s"},
        joint_names=[JOINTS.names[i] for i in order],
        points=[{"positions": [said[i] for i in order]}] * 2,
    )
    assert read(document).points[0].positions == pytest.approx(tuple(values), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    "units",
    [
        ..., None, "rad", [], {}, {"angle": "rad"}, {"angle": "rad", "time": "s"}, {**UNITS, "angle": "degree"},
        {**UNITS, "length": "cm"}, {**UNITS, "length": "M"}, {**UNITS, "length": 1}, {**UNITS, "time": "ms"},
        {**UNITS, "mass": "kg"}, {**UNITS, "angle": ["rad"]}, {**UNITS, "length": None},
    ],
)  # fmt: skip
def test_a_unit_that_is_not_said_is_never_guessed(units):
    reason, sentence = refusal(plain(units=units))
    assert reason == "format" and "unit" in sentence


@pytest.mark.parametrize(
    "names",
    [
        [], ["track", "joint_a1"], ["track", "joint_a1", "joint_a1"], ["track", "joint_a1", "joint_a3"],
        ["track", "joint_a1", "joint_a2", "joint_a3"], 
    ],
)  # fmt: skip
def test_the_joints_must_be_the_robot_s_each_once(names):
    reason, sentence = refusal(plain(joint_names=names))
    assert reason == "joints" and "track, joint_a1, joint_a2" in sentence


@pytest.mark.parametrize(
    "value", [None, True, False, "1", [1.0], {}, 10**400, -(10**400), 1e7, -1e7, LARGEST + 1, "nan", "1e3"]
)
def test_only_numbers_that_an_arm_could_have_are_read(value):
    points = [{"positions": [0.0, 0.0, 0.0]}, {"positions": [0.0, value, 0.0]}]
    reason, sentence = refusal(plain(points=points))
    assert reason == "values" and "points.1.positions.1" in sentence


@pytest.mark.parametrize("word", [b"NaN", b"Infinity", b"-Infinity", b"1e999", b"-1e999"])
@pytest.mark.parametrize("key", ["positions", "velocities", "accelerations", "time_from_start"])
def test_what_is_no_finite_number_is_refused_wherever_it_stands(word, key):
    points = plain()["points"]
    points[1][key] = "HERE" if key == "time_from_start" else [0.0, "HERE", 0.0]
    payload = json.dumps(plain(points=points)).encode().replace(b'"HERE"', word)
    assert refusal(payload)[0] == "values"


@pytest.mark.parametrize(
    "points, reason",
    [
        (None, "format"), ({}, "format"), ([1], "format"), ([[]], "format"), ([{}], "format"),
        ([{"positions": []}], "values"), ([{"positions": [1.0, 2.0]}], "values"),
        ([{"positions": [1.0, 2.0, 3.0, 4.0]}], "values"), ([{"positions": {"track": 1.0}}], "format"),
        ([{"positions": [0, 0, 0], "velocity": [0, 0, 0]}], "format"),
        ([{"positions": [0, 0, 0], "velocities": [0, 0]}], "values"),
        ([{"positions": [0, 0, 0], "velocities": [0, 0, 0]}, {"positions": [0, 0, 0]}], "values"),
        ([{"positions": [0, 0, 0], "time_from_start": -0.1}], "values"),
        ([{"positions": [0, 0, 0], "time_from_start": {"secs": 1}}], "values"),
    ],
)  # fmt: skip
def test_points_that_are_not_as_written_are_refused(points, reason):
    assert refusal(plain(points=points))[0] == reason


def test_a_motion_without_times_has_none():
    request = read(plain(points=[{"positions": [0, 0, 0]}, {"positions": [1, 1, 1]}]))
    assert [point.time_ns for point in request.points] == [0, 0] and request.points[0].velocities == ()


@pytest.mark.parametrize("key", ["velocities", "accelerations"])
def test_velocities_without_times_are_refused_because_they_would_be_dropped(key):
    points = [{"positions": [0, 0, 0], key: [0, 0, 0]}, {"positions": [1, 1, 1], key: [0.1, 0, 0]}]
    assert "without times" in refusal(plain(points=points))[1]


@pytest.mark.parametrize(
    "changes", [{"id": ...}, {"id": ""}, {"id": "x" * 65}, {"id": 7}, {"id": "a\nb"}, {"source": "a\x00b"}, {"source": 1},
                {"extra": 1}, {"points": ...}, {"joint_names": ...}],
)  # fmt: skip
def test_a_message_with_other_keys_is_refused_by_name(changes):
    assert refusal(plain(**changes))[0] == "format"


@pytest.mark.parametrize("scale", [-0.1, 1.1, True, "1", None, math.nan])
@pytest.mark.parametrize("key", ["speed_scale", "acceleration_scale"])
def test_a_scale_is_a_fraction(key, scale):
    points = [{"positions": [0, 0, 0]}, {"positions": [1, 1, 1]}]
    reason, sentence = refusal(plain(points=points, **{key: scale}))
    assert reason == "values" and key in sentence
    assert getattr(read(plain(points=points, **{key: 0.25})), key) == 0.25


@pytest.mark.parametrize("key", ["speed_scale", "acceleration_scale"])
def test_a_scale_of_a_motion_with_times_is_refused_because_it_would_have_no_effect(key):
    expected = f"{key} is for a motion without times; leave it out, or time_from_start"
    assert refusal(plain(**{key: 0.5})) == ("values", expected)


@pytest.mark.parametrize("count", [0, 1])
def test_a_motion_has_two_points_because_a_sender_cannot_know_where_the_twin_is(count):
    reason, sentence = refusal(plain(points=plain()["points"][:count]))
    assert reason == "values" and sentence.startswith(f"{count} points; expected at least two")


# -- the message


def test_a_retained_trajectory_is_refused_whatever_it_says():
    for payload in (b"", json.dumps(plain()).encode()):
        with pytest.raises(PayloadError, match="publish it without the retain flag") as caught:
            read_document(payload, True, "trajectory", LIMIT)
        assert caught.value.reason == "retained"


def test_a_trajectory_that_is_too_long_is_not_even_read():
    payload = json.dumps(plain()).encode()
    assert read_document(payload, False, "trajectory", len(payload)) == plain()
    with pytest.raises(PayloadError, match=f"of {len(payload)} bytes; at most {len(payload) - 1} are read") as caught:
        read_document(payload, False, "trajectory", len(payload) - 1)
    assert caught.value.reason == "size"


@pytest.mark.parametrize(
    "document",
    [
        (PLAIN | {"points": [1] * 1000}),
        (PLAIN | {"joint_names": [1] * 1000}),
        *((PLAIN | {"points": [{"positions": [1.0], key: [None] * 1000}] * 9})
          for key in ("positions", "velocities", "accelerations")),
        (PLAIN | {"points": [dict.fromkeys(map(str, range(1000)), 1)]}),
        (PLAIN | dict.fromkeys(map(str, range(1000)), 1)),
    ],
)  # fmt: skip
def test_a_message_full_of_faults_is_refused_for_its_first_ones_as_stops_wait_for_the_reading(document):
    with pytest.raises(pydantic.ValidationError) as caught:
        TrajectoryMessage.model_validate(document)
    assert caught.value.error_count() <= 10
    with pytest.raises(PayloadError) as refused:
        parse_trajectory(document, JOINTS)
    assert len(str(refused.value)) < 600


@pytest.mark.parametrize(
    "payload",
    [
        b"", b"null", b"[]", b"3", b"{", b"\xff\xfe", b"[" * 50_000, b'{"a":' * 15_000, b'{"id": "1", "id": "2"}',
        b'{"units": {"angle": "rad", "angle": "deg"}}', b"9" * 50_000, json.dumps(PLAIN).encode() + b"}",
    ],
)  # fmt: skip
def test_what_is_no_json_object_with_each_key_once_is_refused(payload):
    assert refusal(payload)[0] == "format"


@given(st.binary(max_size=300))
def test_no_bytes_do_more_than_be_refused(payload):
    assert refusal(payload)[0] == "format"


keys = st.text(max_size=8) | st.sampled_from(["time_from_start", "velocities"])
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.sampled_from(["rad", "m", "s"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(keys, inner, max_size=4),
    max_leaves=12,
)


def places(node, path=()):
    """Return the way to every value of a document."""
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [path, *(place for key, value in inner for place in places(value, (*path, key)))]


@given(st.sampled_from(places(PLAIN)[1:]), json_values)
def test_any_value_in_any_place_is_either_read_as_finite_numbers_or_refused(where, value):
    document = copy.deepcopy(PLAIN)
    *way, last = where
    node = document
    for step in way:
        node = node[step]
    node[last] = value
    try:
        request = read(document)
    except PayloadError as error:
        assert error.reason in ("format", "joints", "values") and len(str(error)) < 600
    else:
        for point in request.points:
            numbers = (*point.positions, *point.velocities, *point.accelerations)
            assert len(point.positions) == 3 and all(map(math.isfinite, numbers)) and point.time_ns >= 0
