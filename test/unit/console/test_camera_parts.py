"""Addresses of cameras, pictures in a stream, topics in what a broker sends, and whose right counts. All pure."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mqtt_packets import packet, text
from sentence_checks import expects, says

from construction_twin.console.camera_rights import CameraRights, TopicScanner
from construction_twin.console.mjpeg import PictureReader, boundary_of
from construction_twin.core.camera_address import MOST, CameraAddress, camera_of, cameras_of
from construction_twin.core.errors import ConfigurationError, PayloadError

FRAME = b"\xff\xd8picture\xff\xd9"
LARGEST = 1000


def part(picture: bytes = FRAME, length: bool = True, mark: bytes = b"--frame", end: bytes = b"\r\n") -> bytes:
    lines = [mark, b"Content-Type: image/jpeg"]
    if length:
        lines.append(b"Content-Length: %d" % len(picture))
    return end.join([*lines, b"", picture, b""])


def cut(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted(at % (len(data) + 1) for at in cuts), len(data)]
    return [data[begin:end] for begin, end in zip(edges, edges[1:])]


# -- addresses


def test_a_camera_is_named_with_its_address_and_robot():
    assert camera_of("front=http://10.0.0.7:8080/a/b?x=1&y=@2@kr120") == CameraAddress(
        "front", "kr120", "10.0.0.7", 8080, "/a/b?x=1&y=@2"
    )
    assert camera_of("front=http://cam.cell", "kr120") == CameraAddress("front", "kr120", "cam.cell", 80, "/")
    assert camera_of("front=http://[::1]:81/s@one").host == "::1"
    assert camera_of("front=http://a/s@one").topic("twin") == "twin/one/camera/front"


@pytest.mark.parametrize(
    "words",
    [
        "", "front", "front=", "front=http://a/s", "front=https://a/s@one", "front=file:///etc/passwd@one", "=http://a@one",
        "fr/ont=http://a/s@one", "front=http://a/s@o+e", "front=http://user:secret@a/s@one", "front=http://a/s#x@one",
        "front=http://a:99999/s@one", "front=http://a/ü@one", "front=http://a/s\x00@one", "front=http:///s@one",
    ],
)  # fmt: skip
def test_what_is_no_camera_is_refused(words):
    with pytest.raises(ConfigurationError, check=expects("expected.camera")):
        camera_of(words)


def test_cameras_of_a_robot_have_names_of_their_own_and_are_not_too_many():
    assert len(cameras_of(["a=http://a/ b=http://a/", "a=http://b/@two"], "one")) == 3
    assert cameras_of([""]) == ()
    for wrong in ("a=http://a/ a=http://b/", " ".join(f"c{k}=http://a/" for k in range(MOST + 1))):
        with pytest.raises(ConfigurationError, check=expects("expected.cameras", most=MOST)):
            cameras_of([wrong], "one")


# -- the head of the answer


def head(kind: str, status: str = "HTTP/1.1 200 OK", more: str = "") -> bytes:
    return f"{status}\r\nServer: x\r\ncontent-type: {kind}\r\n{more}\r\n".encode()


@pytest.mark.parametrize(
    "kind, boundary",
    [
        ("multipart/x-mixed-replace; boundary=frame", b"frame"),
        ('Multipart/X-Mixed-Replace;charset=utf-8; Boundary="a b"', b"a b"),
        ("multipart/x-mixed-replace;boundary=--myboundary", b"--myboundary"),
    ],
)
def test_the_boundary_is_read(kind, boundary):
    assert boundary_of(head(kind)) == boundary


@pytest.mark.parametrize(
    "answer, key",
    [
        (head("multipart/x-mixed-replace; boundary=f", "HTTP/1.1 401 Unauthorized"), "view.camera.status"),
        (head("multipart/x-mixed-replace; boundary=f", "HTTP/1.1 302 Found", "Location: http://x/\r\n"), "view.camera.status"),
        (b"SSH-2.0-x\r\n\r\n", "view.camera.status"),
        (head("image/jpeg"), "view.camera.kind"),
        (head("multipart/x-mixed-replace"), "view.camera.kind"),
        (head(f"multipart/x-mixed-replace; boundary={'x' * 100}x"), None),
        (head("multipart/x-mixed-replace; boundary=f", more="Transfer-Encoding: chunked\r\n"), "view.camera.encoding"),
        (b"HTTP/1.0 200 OK\r\n\r\n", "view.camera.kind"),
    ],
)  # fmt: skip
def test_an_answer_that_is_no_stream_is_refused(answer, key):
    if key is None:
        # a mark that is cut is none that the stream has: nothing is found then
        assert len(boundary_of(answer)) <= 72
        return
    with pytest.raises(PayloadError, check=says(key)):
        boundary_of(answer)


# -- pictures


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.binary(max_size=60), min_size=1, max_size=5),
    st.lists(st.integers(0, 10**6), max_size=12),
    st.booleans(),
    st.sampled_from([b"\r\n", b"\n"]),
    st.binary(max_size=40),
)
def test_pictures_are_the_same_however_the_stream_is_cut(bodies, cuts, length, end, preamble):
    pictures = [b"\xff\xd8" + body.replace(b"--frame", b"") + b"\xff\xd9" for body in bodies]
    stream = preamble.replace(b"--frame", b"").replace(b"-", b"") + end
    stream += b"".join(part(each, length, end=end) for each in pictures) + b"--frame\r\n"
    reader = PictureReader(b"frame", LARGEST)
    found = [picture for piece in cut(stream, cuts) for picture in reader.feed(piece)]
    assert found == pictures and reader.refused == 0


@settings(max_examples=300, deadline=None)
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=200),
            st.sampled_from([
                b"--frame", b"--frame--", b"\r\n", b"\n", b"--", b"Content-Length: ", b"Content-Length: 5\r\n", b"999999999999\r\n",
                b"Content-Length: -1\r\n", b"\xff\xd8", part(), part(length=False), part(b"no picture"), b"x" * 700,
            ]),
        ),
        max_size=30,
    )
)  # fmt: skip
def test_hostile_bytes_end_in_pictures_or_a_refusal_and_take_no_memory(pieces):
    reader = PictureReader(b"frame", LARGEST)
    for piece in pieces:
        try:
            for picture in reader.feed(piece):
                assert picture.startswith(b"\xff\xd8") and len(picture) <= LARGEST
        except PayloadError as error:
            assert error.reason in ("mjpeg", "size")
            return
        assert reader.kept <= LARGEST + 4096 + 100


@pytest.mark.parametrize(
    "stream",
    [
        b"--frame\r\nContent-Length: 1001\r\n\r\n",
        b"--frame\r\n\r\n" + b"\xff\xd8" + b"x" * 1100,
        b"--frame\r\n" + b"X: y\r\n" * 1000,
        b"--frame\r\nX: " + b"y" * 5000,
        b"--frame" + b"y" * 5000,
        b"x" * 1100,
        b"--frame\r\nContent-Length: ten\r\n\r\n",
        b"--frame--\r\n",
    ],
)
def test_what_is_too_long_or_at_its_end_is_refused(stream):
    with pytest.raises(PayloadError):
        PictureReader(b"frame", LARGEST).feed(stream)


def test_a_part_that_is_no_picture_is_counted_and_left_out():
    reader = PictureReader(b"--frame", LARGEST)
    assert reader.feed(part(b"<html>") + part() + part(b"")) == [FRAME]
    assert reader.refused == 2


# -- topics


def publish(topic: str, payload: bytes = b"{}", qos: int = 0) -> bytes:
    return packet(3, text(topic) + (b"\0\1" if qos else b"") + b"\0" + payload, 2 * qos)


@settings(max_examples=200, deadline=None)
@given(
    st.lists(
        st.one_of(
            st.tuples(st.text("abc/é", min_size=1, max_size=40), st.binary(max_size=400)).map(
                lambda pair: (pair[0], publish(*pair))
            ),
            st.sampled_from([(None, b"\xd0\0"), (None, packet(9, b"\0\1\0\x00")), (None, b"\x20\x03\0\0\0")]),
        ),
        max_size=8,
    ),
    st.lists(st.integers(0, 10**6), max_size=20),
)
def test_topics_are_the_same_however_the_bytes_are_cut(packets, cuts):
    scanner = TopicScanner()
    found = [topic for piece in cut(b"".join(data for _, data in packets), cuts) for topic in scanner.feed(piece)]
    assert found == [topic for topic, _ in packets if topic is not None]


@given(st.lists(st.binary(max_size=300), max_size=10))
def test_whatever_comes_the_scanner_keeps_little_and_raises_nothing(pieces):
    scanner = TopicScanner()
    for piece in pieces:
        scanner.feed(piece)
        assert scanner.kept <= 210


def test_a_topic_inside_of_a_payload_is_none():
    assert TopicScanner().feed(publish("other", publish("twin/one/camera/front"))) == ["other"]
    # and one that is longer than its packet, or too long, is passed over
    assert TopicScanner().feed(packet(3, b"\x00\x30abc") + publish("a")) == ["a"]
    assert TopicScanner().feed(publish("x" * 300) + publish("a")) == ["a"]
    assert TopicScanner().feed(packet(3, b"") + packet(3, b"\0") + publish("a")) == ["a"]
    assert TopicScanner().feed(b"\x30\xff\xff\xff\xff\xff" + publish("a")) == []


# -- rights

TOPIC, OTHER = "twin/one/camera/front", "twin/one/camera/side"


def test_who_was_sent_the_topic_may_see_the_camera_on_any_connection_of_the_account_and_for_a_while():
    rights = CameraRights([TOPIC, OTHER], 30.0)
    assert not rights.may_see(["ada"], TOPIC, 0.0)
    rights.delivered(1, "ada", TOPIC, 0.0)
    assert rights.may_see(["bob", "ada"], TOPIC, 30.0)
    assert not rights.may_see(["bob"], TOPIC, 1.0) and not rights.may_see(["ada"], OTHER, 1.0)
    assert not rights.may_see([], TOPIC, 1.0)
    assert not rights.may_see(["ada"], TOPIC, 30.1)
    rights.delivered(2, "ada", TOPIC, 25.0)
    rights.ended(1)
    assert rights.may_see(["ada"], TOPIC, 30.0)
    rights.ended(2)
    assert not rights.may_see(["ada"], TOPIC, 30.0)


def test_other_topics_leave_nothing_behind():
    rights = CameraRights([TOPIC], 30.0)
    for number in range(100):
        rights.delivered(1, "ada", f"twin/one/camera/{number}", 0.0)
    assert rights.kept == 0
