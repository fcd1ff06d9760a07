"""Notes between two processes, and how each end learns that the other is gone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Thread

import pytest

from mlbs_actors.actors.ipc.channels import (
    Channel,
    ChannelAddress,
    ChannelClosedError,
    ChannelListener,
    connect,
)

#: Connects to a channel and sends every message back, doubled, until it is closed.
_ECHO = """
import sys
from mlbs_actors.actors.ipc.channels import ChannelClosedError, ChannelAddress, connect

channel = connect(ChannelAddress(*map(int, sys.argv[1:])))
try:
    while True:
        channel.send(channel.receive() * 2)
except ChannelClosedError:
    print("closed")
"""

#: Listens for a channel, prints its address, and echoes as above what comes through it.
_OFFERING = """
from mlbs_actors.actors.ipc.channels import ChannelListener

listener = ChannelListener()
address = listener.address
print(address.owner, address.outgoing, address.incoming, flush=True)
with listener.accept() as channel:
    channel.send(channel.receive() * 2)
    channel.receive()
"""


@contextmanager
def echo() -> Iterator[tuple[Channel, subprocess.Popen[str]]]:
    listener = ChannelListener()
    address = listener.address
    numbers = [str(number) for number in (address.owner, address.outgoing, address.incoming)]
    with subprocess.Popen(
        [sys.executable, "-c", _ECHO, *numbers], stdout=subprocess.PIPE, text=True
    ) as other:
        with listener.accept() as channel:
            yield channel, other
        other.kill()


def _send_all(channel: Channel, notes: Sequence[object]) -> None:
    for note in notes:
        channel.send(note)


def test_notes_of_any_size_come_in_order() -> None:
    notes = ["a", b"b" * 5_000, "c" * 300_000, (1, 2)]
    with echo() as (channel, _):
        # More than a pipe holds: the other end must be read meanwhile.
        sender = Thread(target=_send_all, args=(channel, notes))
        sender.start()
        assert [channel.receive() for _ in notes] == [note * 2 for note in notes]  # type: ignore[operator]
        sender.join()


def test_a_note_that_is_there_is_told() -> None:
    with echo() as (channel, _):
        assert not channel.has_message()
        channel.send("now")
        assert channel.receive() == "nownow"
        assert not channel.has_message()


def test_both_ends_learn_that_the_other_process_was_killed_after_its_last_note() -> None:
    with echo() as (channel, other):
        channel.send("last")
        while not channel.has_message():
            continue
        os.kill(other.pid, signal.SIGKILL)
        other.wait()
        assert channel.receive() == "lastlast"
        with pytest.raises(ChannelClosedError):
            channel.receive()
        with pytest.raises(ChannelClosedError):
            channel.send("never")


def test_the_other_end_learns_that_this_one_is_closed() -> None:
    with echo() as (channel, other):
        channel.close()
        assert other.communicate()[0] == "closed\n"


def test_who_took_a_channel_learns_that_its_owner_was_killed() -> None:
    with subprocess.Popen([sys.executable, "-c", _OFFERING], stdout=subprocess.PIPE, text=True) as owner:
        assert owner.stdout is not None
        channel = connect(ChannelAddress(*map(int, owner.stdout.readline().split())))
        channel.send("one")
        assert channel.receive() == "oneone"
        owner.kill()
        owner.wait()
        with channel, pytest.raises(ChannelClosedError):
            channel.receive()


def test_a_channel_whose_owner_is_gone_cannot_be_taken() -> None:
    with subprocess.Popen(["true"]) as gone:
        gone.wait()
        with pytest.raises(ChannelClosedError):
            connect(ChannelAddress(gone.pid, 3, 4))
