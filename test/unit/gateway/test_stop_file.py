"""What keeps a stop beyond the gateway's program: in place, beside the loop, and read before anything else."""

from __future__ import annotations

import os
import threading

import pytest
from processes import wait_until

from construction_twin.core.errors import ConfigurationError
from construction_twin.gateway.stop_file import ROOM, StopFile

STOP = "stop: asked for by account anna"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "kr120.stopped"


def kept(path, reason):
    """Keep a reason, as a program that ends then."""
    stops = StopFile(path)
    stops.save(reason)
    stops.close()
    return stops


def test_a_stop_outlasts_the_program_until_it_was_reset(path):
    assert StopFile(path).found == ""
    kept(path, STOP)
    assert kept(path, STOP).found == STOP
    kept(path, "")
    assert StopFile(path).found == ""


def test_it_is_on_the_disk_at_once_and_takes_no_more_room_than_there_was(path):
    stops = StopFile(path)
    assert path.stat().st_size == ROOM
    stops.save(STOP + "x" * 5000)
    wait_until(lambda: path.read_text().startswith(STOP), what="the stop on the disk")
    assert path.stat().st_size == ROOM
    stops.close()


def test_nobody_waits_for_a_disk_that_hangs_and_the_newest_counts(path, monkeypatch):
    stops = StopFile(path)
    hangs, asked, write = threading.Event(), threading.Event(), os.write

    def slow(file, data):
        asked.set()
        hangs.wait(10.0)
        return write(file, data)

    monkeypatch.setattr(os, "write", slow)
    stops.save(STOP)
    assert asked.wait(10.0)
    stops.save("")
    stops.save("stop: asked for by account bob")
    hangs.set()
    stops.close()
    assert StopFile(path).found == "stop: asked for by account bob"


def test_what_could_not_be_written_is_said_and_tried_again(path, monkeypatch, caplog):
    stops = StopFile(path)
    with monkeypatch.context() as broken:
        broken.setattr(os, "fsync", lambda file: (_ for _ in ()).throw(OSError(5, "Input/output error")))
        stops.save(STOP)
        wait_until(lambda: "Input/output error" in caplog.text, what="the sentence")
        path.write_text("")
    wait_until(lambda: path.read_text().strip() == STOP, what="the stop on the disk")
    stops.close()


def test_a_name_that_is_no_text_ends_no_writer(path):
    stops = StopFile(path)
    stops.save("stop: asked for by \ud800")
    stops.close()
    assert StopFile(path).found == "stop: asked for by ?"


def test_what_cannot_be_read_was_a_stop(path):
    path.write_bytes(b"\xff" * 10)
    assert str(path) in StopFile(path).found


@pytest.mark.parametrize("where", ["no/such/folder/file", "."])
def test_without_a_file_the_gateway_does_not_start(tmp_path, where):
    with pytest.raises(ConfigurationError, match="--stop-file"):
        StopFile(tmp_path / where)
