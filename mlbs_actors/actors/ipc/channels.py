"""Message channels between two processes of a stream, on one node and without Ray between them.

A call through Ray takes a millisecond of CPU time, in three processes; a message through a pipe takes a
fiftieth of that. Ray starts and ends the processes and reports their failures; the messages of every frame
use these pipes, and arrays use shared memory (:mod:`mlbs_actors.actors.ipc.shared_memory`).

One process listens, another one connects. Like that memory, the pipes have no name: they are opened through
their owner's ``/proc`` entry, which the system grants to the same user only, and they vanish with their
processes. When a process ends, the other end of its channel is notified at once.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

__all__ = ["Channel", "ChannelAddress", "ChannelClosedError", "ChannelListener", "connect"]


class ChannelClosedError(Exception):
    """The process at the other end has closed the channel or is gone; Ray knows why."""


@dataclass(frozen=True, slots=True)
class ChannelAddress:
    """Where another process finds the other end of a channel.

    Attributes
    ----------
    owner : int
        Process id of the listener.
    outgoing, incoming : int
        The owner's file descriptors of the pipes to write to, and to read from.
    """

    owner: int
    outgoing: int
    incoming: int


class Channel:
    """One end of a channel; closed at the end of a ``with`` block.

    Parameters
    ----------
    incoming, outgoing : Connection
    """

    def __init__(self, incoming: Connection, outgoing: Connection) -> None:
        self._incoming = incoming
        self._outgoing = outgoing

    def send(self, message: object) -> None:
        """Send a picklable message of some kilobytes; raises ChannelClosedError."""
        try:
            self._outgoing.send_bytes(pickle.dumps(message, pickle.HIGHEST_PROTOCOL))
        except OSError:
            raise ChannelClosedError from None

    def receive(self) -> Any:
        """Wait for the next message, even from a process that has ended since; raises ChannelClosedError."""
        try:
            return pickle.loads(self._incoming.recv_bytes())
        except (EOFError, OSError):
            raise ChannelClosedError from None

    def has_message(self, seconds: float = 0.0) -> bool:
        """Whether :meth:`receive` would return within this time, s."""
        return self._incoming.poll(seconds)

    def close(self) -> None:
        """Close both directions; the other end gets ChannelClosedError."""
        self._incoming.close()
        self._outgoing.close()

    def __enter__(self) -> Channel:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


class ChannelListener:
    """A new channel to which one other process is to connect.

    Attributes
    ----------
    address : ChannelAddress
        For that process.
    """

    def __init__(self) -> None:
        self._incoming, self._other_outgoing = _pipe()
        self._other_incoming, self._outgoing = _pipe()
        self.address = ChannelAddress(
            os.getpid(), self._other_outgoing.fileno(), self._other_incoming.fileno()
        )

    def accept(self) -> Channel:
        """Wait, without limit, until the other process has connected; return the channel."""
        channel = Channel(self._incoming, self._outgoing)
        channel.receive()
        # From now on only the other process has these ends open, so this one notices when it ends.
        self._other_outgoing.close()
        self._other_incoming.close()
        return channel

    def serve(self, answers: Callable[[Any], Iterable[object]]) -> None:
        """Answer messages until the other end is closed.

        Parameters
        ----------
        answers : callable
            Yields the answers to a message. ChannelClosedError raised in it ends the loop, too.
        """
        with suppress(ChannelClosedError), self.accept() as channel:
            while True:
                for answer in answers(channel.receive()):
                    channel.send(answer)


def _pipe() -> tuple[Connection, Connection]:
    """Return the ends of a new pipe, to read from and to write to."""
    reading, writing = os.pipe()
    return Connection(reading, writable=False), Connection(writing, readable=False)


def connect(address: ChannelAddress) -> Channel:
    """Connect to a listener, once; raises ChannelClosedError if its process is gone."""
    ends = []
    try:
        for descriptor, flags in ((address.incoming, os.O_RDONLY), (address.outgoing, os.O_WRONLY)):
            opened = os.open(f"/proc/{address.owner}/fd/{descriptor}", flags | os.O_CLOEXEC)
            ends.append(Connection(opened, readable=not flags, writable=bool(flags)))
    except OSError:
        for end in ends:
            end.close()
        raise ChannelClosedError from None
    channel = Channel(*ends)
    channel.send(None)
    return channel
