"""Messages between two processes of a stream, on one node and without Ray between them.

A call through Ray takes a millisecond of CPU time, in three processes; a message through a pipe takes a
fiftieth of that. Ray starts and ends the processes, and tells what became of them; what passes between them
for every frame goes this way, the arrays through memory (:mod:`mlbs_actors.actors.ipc.shared_memory`).

One process offers a channel, another one takes it. Like that memory, the pipes have no name: they are found
through their owner's ``/proc`` entry, which the system opens for the same user only, and nothing is left of
them however a process ends. Who holds one end learns at once when the other end's process is gone.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

__all__ = ["Channel", "ChannelAddress", "ChannelClosedError", "ChannelListener", "connect"]


class ChannelClosedError(Exception):
    """The process at the other end has closed the channel, or is gone: why, Ray knows."""


@dataclass(frozen=True, slots=True)
class ChannelAddress:
    """Where the other end of a channel is to be had.

    Attributes
    ----------
    owner : int
        Process id of who offers it.
    outgoing, incoming : int
        The owner's file descriptors of what is to be written to, and to be read from.
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
        """Wait for the next message, also of a process that has ended since; raises ChannelClosedError."""
        try:
            return pickle.loads(self._incoming.recv_bytes())
        except (EOFError, OSError):
            raise ChannelClosedError from None

    def has_message(self, seconds: float = 0.0) -> bool:
        """Whether :meth:`receive` would not wait, or after so many seconds would not."""
        return self._incoming.poll(seconds)

    def close(self) -> None:
        """Let the other end know that no more messages come from here, and that none are read."""
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
    """A new channel whose other end one other process is to take.

    Attributes
    ----------
    address : ChannelAddress
        To be told to that process.
    """

    def __init__(self) -> None:
        self._incoming, self._other_outgoing = Pipe(duplex=False)
        self._other_incoming, self._outgoing = Pipe(duplex=False)
        self.address = ChannelAddress(
            os.getpid(), self._other_outgoing.fileno(), self._other_incoming.fileno()
        )

    def accept(self) -> Channel:
        """Wait, as long as it takes, until the other end has been taken; return this one."""
        channel = Channel(self._incoming, self._outgoing)
        channel.receive()
        # From now on only the other process holds that end: if it goes, this one is told.
        self._other_outgoing.close()
        self._other_incoming.close()
        return channel

    def serve(self, answers: Callable[[Any], Iterable[object]]) -> None:
        """Answer the messages that come, once the other end has been taken, until that is closed.

        Parameters
        ----------
        answers : callable
            What is to be sent back for a message, as it is made. If it finds a channel of its own closed,
            that is the end, too.
        """
        with suppress(ChannelClosedError), self.accept() as channel:
            while True:
                for answer in answers(channel.receive()):
                    channel.send(answer)


def connect(address: ChannelAddress) -> Channel:
    """Take the other end of an offered channel, once; raises ChannelClosedError if its process is gone."""
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
