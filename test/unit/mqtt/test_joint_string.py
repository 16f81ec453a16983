"""The joint string: golden strings, rounding, every illegal payload, axis mapping."""

from __future__ import annotations

import math
from decimal import ROUND_HALF_EVEN, Decimal
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.errors import ConfigurationError, PayloadError
from construction_twin.core.units import degrees, radians
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.robot.description import read_robot_files

ROOT = Path(__file__).parents[3]
GOLDEN = b"+012.345,-090.000,+090.000,+000.000,+045.000,+000.000"
ZEROS = b"+000.000,+000.000,+000.000,+000.000,+000.000,+000.000"
PAPER = JointStringCodec(6)

decimals = st.integers(1, 6)
angles = st.floats(math.radians(-999.9), math.radians(999.9))
poses = st.lists(angles, min_size=6, max_size=6).map(tuple)
mappings = st.lists(st.tuples(st.sampled_from([1, -1]), st.floats(-math.pi, math.pi)), min_size=6, max_size=6)


def one_joint(decimals: int, q_deg: float) -> bytes:
    """Encode one joint whose angle in degrees is exactly `q_deg` after the conversion from rad."""
    near = math.radians(q_deg)
    candidates = (near, math.nextafter(near, 9.0), math.nextafter(near, -9.0))
    exact = next(q for q in candidates if math.degrees(q) == q_deg)
    return JointStringCodec(1, decimals).encode((exact,))


def refusal(codec: JointStringCodec, payload: bytes) -> PayloadError:
    with pytest.raises(PayloadError) as caught:
        codec.decode(payload)
    return caught.value


def test_encodes_the_design_s_golden_string():
    assert PAPER.encode(radians((12.345, -90.0, 90.0, 0.0, 45.0, 0.0))) == GOLDEN
    assert len(GOLDEN) == PAPER.length == 53


def test_decodes_the_golden_string_into_rad():
    assert PAPER.decode(GOLDEN) == radians((12.345, -90.0, 90.0, 0.0, 45.0, 0.0))


@pytest.mark.parametrize("count, text", [(1, b"-001.5"), (3, b"-001.500"), (4, b"-001.5000"), (6, b"-001.500000")])
def test_every_number_of_decimals_keeps_three_digits_before_the_point(count, text):
    assert one_joint(count, -1.5) == text


@pytest.mark.parametrize(
    "count, q_deg, text",
    [
        (2, 0.125, b"+000.12"),  # exact ties go to the even digit
        (2, 0.375, b"+000.38"),
        (2, -0.125, b"-000.12"),
        (1, 0.25, b"+000.2"),
        (1, 0.75, b"+000.8"),
        (2, 0.005, b"+000.01"),  # no tie: the double nearest to 0.005 lies above it
        (2, 1.005, b"+001.00"),  # and this one below
    ],
)
def test_rounds_half_even_on_the_exact_binary_value(count, q_deg, text):
    assert one_joint(count, q_deg) == text


@given(decimals, angles)
def test_rounding_is_that_of_exact_decimal_arithmetic(count, q):
    exact = Decimal(math.degrees(q)).quantize(Decimal(1).scaleb(-count), rounding=ROUND_HALF_EVEN)
    assert Decimal(JointStringCodec(1, count).encode((q,)).decode()) == exact


@pytest.mark.parametrize("q_deg", [0.0, -0.0, -1e-9, -0.0004999, 0.0004999])
def test_zero_is_never_negative(q_deg):
    assert PAPER.encode((math.radians(q_deg),) * 6) == ZEROS


def test_a_negative_zero_from_elsewhere_is_the_same_pose():
    assert PAPER.decode(ZEROS.replace(b"+", b"-")) == PAPER.decode(ZEROS)
    assert PAPER.encode(PAPER.decode(ZEROS.replace(b"+", b"-"))) == ZEROS


def test_negative_values_that_only_begin_with_zeros_keep_their_sign():
    assert PAPER.encode(radians((-0.001, -0.0006, -0.1, -100.0, -10.0, 0.0)))[:17] == b"-000.001,-000.001"


@pytest.mark.parametrize("q", [(0.0,) * 5, (0.0,) * 7, ()])
def test_encode_refuses_another_joint_count(q):
    with pytest.raises(PayloadError) as caught:
        PAPER.encode(q)
    assert caught.value.reason == "count"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_encode_refuses_what_is_not_finite(value):
    with pytest.raises(PayloadError) as caught:
        PAPER.encode((0.0,) * 5 + (value,))
    assert caught.value.reason == "values"


@pytest.mark.parametrize("q_deg", [1000.0, -1000.0, 999.9995, 1e6])
def test_encode_refuses_a_thousand_degrees_after_rounding(q_deg):
    with pytest.raises(PayloadError) as caught:
        PAPER.encode((math.radians(q_deg),) + (0.0,) * 5)
    assert caught.value.reason == "range"


@pytest.mark.parametrize("q", [1e308, -1e308])
def test_encode_refuses_a_finite_angle_that_is_infinite_in_degrees(q):
    with pytest.raises(PayloadError) as caught:
        PAPER.encode((q,) + (0.0,) * 5)
    assert caught.value.reason == "range"


def test_the_largest_value_that_fits_is_accepted():
    assert PAPER.encode((math.radians(999.9994),) * 6).startswith(b"+999.999,")


@pytest.mark.parametrize(
    "payload, reason",
    [
        (b"", "length"),
        (GOLDEN[:-1], "length"),
        (GOLDEN + b"\n", "length"),
        (GOLDEN + b"\0", "length"),
        (b" " + GOLDEN, "length"),
        (GOLDEN[:-9], "length"),  # five joints
        (GOLDEN + b",+000.000", "length"),  # seven
        (GOLDEN * 1000, "length"),
        (GOLDEN.replace(b"+012.345", b" 012.345"), "format"),
        (GOLDEN.replace(b"+012.345", b"0012.345"), "format"),
        (GOLDEN.replace(b"+012.345", b"+12.3450"), "format"),
        (GOLDEN.replace(b"+012.345", b"+0012.34"), "format"),
        (GOLDEN.replace(b"+012.345", b"+1.2e+01"), "format"),
        (GOLDEN.replace(b"+012.345", b"+000.nan"), "format"),
        (GOLDEN.replace(b"+012.345", b"+0000inf"), "format"),
        (GOLDEN.replace(b"+012.345", b"+01_.345"), "format"),
        (GOLDEN.replace(b"+012.345", b"+012,345"), "format"),
        (GOLDEN.replace(b",", b";"), "format"),
        (GOLDEN.replace(b"+012.345", b"--12.345"), "format"),
        (GOLDEN[:-1] + b"\xb2", "format"),  # superscript two in Latin-1
        ("+01٢.345".encode() + GOLDEN[9:], "format"),  # an Arabic digit two, two bytes in UTF-8
        (GOLDEN.decode().encode("utf-16"), "length"),
    ],
)
def test_decode_refuses(payload, reason):
    assert refusal(PAPER, payload).reason == reason


@pytest.mark.parametrize("count", [1, 2, 4, 6])
def test_another_number_of_decimals_is_one_clear_fault(count):
    error = refusal(PAPER, JointStringCodec(6, count).encode((0.5,) * 6))
    assert error.reason == "decimals"
    assert f"{count} decimals" in str(error) and "configured for 3" in str(error)


def test_a_long_payload_is_not_quoted_in_full():
    assert len(str(refusal(PAPER, b"x" * 100_000))) < 300


@given(decimals, st.one_of(st.binary(max_size=80), st.text("+-0123456789.,", max_size=80).map(str.encode)))
def test_any_bytes_are_a_pose_or_a_counted_refusal(count, payload):
    codec = JointStringCodec(6, count)
    try:
        q = codec.decode(payload)
    except PayloadError as error:
        assert error.reason in {"length", "format", "decimals"} and str(error)
    else:
        assert codec.decode(codec.encode(q)) == q


@given(st.lists(st.integers(-999_999, 999_999), min_size=6, max_size=6))
def test_every_legal_string_survives_decode_and_encode(thousandths):
    payload = ",".join(f"{value / 1000:+08.3f}" for value in thousandths).encode()
    assert PAPER.encode(PAPER.decode(payload)) == payload


@given(decimals, poses)
def test_quantise_moves_no_joint_further_than_half_a_digit_and_is_idempotent(count, q):
    codec = JointStringCodec(6, count)
    once = codec.quantise(q)
    assert codec.quantise(once) == once
    assert codec.encode(once) == codec.encode(q)
    assert max(abs(a - b) for a, b in zip(once, q)) <= math.radians(0.5 * 10.0**-count) + 1e-14


def test_the_wire_carries_the_controller_s_axis_angles():
    codec = JointStringCodec(2, 3, [(-1, 0.0), (1, math.pi / 2)])
    assert codec.encode(radians((30.0, 10.0))) == b"-030.000,+100.000"
    assert codec.decode(b"-030.000,+100.000") == pytest.approx(radians((30.0, 10.0)), abs=1e-15)


@given(decimals, mappings, st.lists(st.floats(-6.0, 6.0), min_size=6, max_size=6).map(tuple))
def test_quantise_is_idempotent_under_any_mapping(count, mapping, q):
    codec = JointStringCodec(6, count, mapping)
    assert codec.encode(codec.quantise(q)) == codec.encode(q)
    assert codec.quantise(codec.quantise(q)) == codec.quantise(q)


def test_a_mapping_that_changes_nothing_is_exact():
    plain, mapped = JointStringCodec(6), JointStringCodec(6, 3, [(1, 0.0)] * 6)
    assert mapped.decode(GOLDEN) == plain.decode(GOLDEN)


def test_the_shipped_robot_s_axes_are_its_joints():
    robot = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
    assert degrees(JointStringCodec.of(robot, 3).decode(GOLDEN)) == pytest.approx((12.345, -90, 90, 0, 45, 0))


@pytest.mark.parametrize("joints, count", [(6, 0), (6, 7), (6, -1), (0, 3)])
def test_a_format_that_makes_no_sense_is_refused(joints, count):
    with pytest.raises(ConfigurationError):
        JointStringCodec(joints, count)


# -- a linear axis, which the paper does not have

TRACK = JointStringCodec(3, 3, axes=("E1", "A1", "A2"), linear=(True, False, False))
RAIL = b"+012.345,-090.000,+01234.567"


def test_a_linear_axis_comes_last_in_mm_with_a_length_of_its_own():
    assert TRACK.encode((1.234567, *radians((12.345, -90.0)))) == RAIL
    assert TRACK.decode(RAIL) == pytest.approx((1.234567, *radians((12.345, -90.0))), abs=1e-15)
    assert TRACK.length == len(RAIL) == 8 + 1 + 8 + 1 + 10


def test_fields_are_in_the_order_of_the_axes_whatever_the_joints_are():
    codec = JointStringCodec(3, 1, axes=("A2", "E1", "A1"), linear=(False, True, False))
    assert codec.encode((math.radians(2.0), -0.003, math.radians(1.0))) == b"+001.0,+002.0,-00003.0"
    assert codec.decode(b"+001.0,+002.0,-00003.0") == (math.radians(2.0), -0.003, math.radians(1.0))


@pytest.mark.parametrize("q", [100.0, -100.0, 99.9999996, 1e306, math.radians(1000.0) * 100])
def test_a_hundred_metres_after_rounding_are_refused(q):
    with pytest.raises(PayloadError, match="a joint is at or beyond 1000 degrees or 100") as caught:
        TRACK.encode((q, 0.0, 0.0))
    assert caught.value.reason == "range"


def test_the_longest_track_that_fits_is_accepted_and_a_turning_axis_keeps_its_own_bound():
    assert TRACK.encode((-99.9999994, 0.0, 0.0)).endswith(b",-99999.999")
    with pytest.raises(PayloadError) as caught:
        TRACK.encode((0.0, math.radians(1000.0), 0.0))
    assert caught.value.reason == "range"


@pytest.mark.parametrize("q", [0.0, -0.0, -1e-9, -4.9e-7])
def test_zero_of_a_linear_axis_is_never_negative(q):
    assert TRACK.encode((q, q / 1e3, 0.0)) == b"+000.000,+000.000,+00000.000"


@pytest.mark.parametrize(
    "payload, reason",
    [
        (RAIL[:-11], "length"),  # the six-joint kind of string: no seventh field
        (RAIL.replace(b"+01234.567", b"+001.235"), "length"),
        (b"+01234.567,+012.345,-090.000", "format"),  # the track first
        (RAIL.replace(b"+01234.567", b"+1234.5670"), "format"),
        (
            JointStringCodec(3, 4, axes=("E1", "A1", "A2"), linear=(True, False, False)).encode((1.0, 0.0, 0.0)),
            "decimals",
        ),
    ],
)
def test_a_string_of_another_form_is_refused(payload, reason):
    assert refusal(TRACK, payload).reason == reason


@given(decimals, st.floats(-99.0, 99.0), st.floats(-6.0, 6.0))
def test_a_linear_axis_is_quantised_once_and_by_half_a_digit_of_a_mm(count, metres, angle):
    codec = JointStringCodec(2, count, [(-1, 0.25), (1, 0.5)], ("E1", "A1"), (True, False))
    once = codec.quantise((metres, angle))
    assert codec.quantise(once) == once
    assert abs(once[0] - metres) <= 0.5e-3 * 10.0**-count + 1e-13


@given(st.lists(st.integers(-999_999, 999_999), min_size=2, max_size=2), st.integers(-99_999_999, 99_999_999))
def test_every_legal_string_with_a_track_survives_decode_and_encode(thousandths, micrometres):
    fields = [f"{value / 1000:+08.3f}" for value in thousandths] + [f"{micrometres / 1000:+010.3f}"]
    payload = ",".join(fields).encode()
    assert TRACK.encode(TRACK.decode(payload)) == payload


@pytest.mark.parametrize("options", [{"axes": ("A1",)}, {"linear": (True,)}])
def test_axes_and_kinds_must_be_one_per_joint(options):
    with pytest.raises(ConfigurationError):
        JointStringCodec(2, 3, **options)


def test_a_robot_without_linear_joints_has_the_papers_string():
    named = JointStringCodec(6, 3, [(1, 0.0)] * 6, [f"A{number}" for number in range(1, 7)], (False,) * 6)
    assert named.encode(radians((12.345, -90.0, 90.0, 0.0, 45.0, 0.0))) == GOLDEN and named.length == PAPER.length
