"""Output of C code stays off the console, output of Python does not."""

import ctypes
import os

from qdgrasp_worker.bullet import quiet


def test_what_c_prints_meanwhile_is_not_seen_even_if_it_is_written_late(capfd):
    with quiet():
        ctypes.CDLL(None).printf(b"from C, buffered\n")
        os.write(1, b"from C, at once\n")
        os.write(2, b"a warning\n")
    ctypes.CDLL(None).fflush(None)
    seen = capfd.readouterr()
    assert seen.out == ""
    assert seen.err == ""


def test_what_is_printed_before_and_after_is_seen(capfd):
    print("before")  # noqa: T201
    with quiet():
        os.write(1, b"meanwhile")
    os.write(1, b"after\n")
    assert capfd.readouterr().out == "before\nafter\n"


def test_streams_come_back_after_an_exception(capfd):
    try:
        with quiet():
            raise ValueError
    except ValueError:
        os.write(1, b"here")
    assert capfd.readouterr().out == "here"
