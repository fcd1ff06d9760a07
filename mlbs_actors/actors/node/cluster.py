"""All nodes of a Ray cluster as one host of streams: each stream runs on one node, frames never leave it.

A node is checked once, before the first stream is placed on it: whether it can be used, and how many streams
it can hold. Nodes may join and be lost at any time; a stream whose node is lost is started again by the
driver, on another.

A stream starts when Ray has reserved its share of a node: so streams wait for other jobs of the cluster, and
these for them. One that goes back to its snapshot keeps its share, or does not wait for another.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from pathlib import Path
from threading import Lock
from typing import Any

import ray
from ray.exceptions import GetTimeoutError, RayError

from mlbs_actors.actors.node.demand import Bundle, Demand
from mlbs_actors.actors.node.failures import cause_of, last_line
from mlbs_actors.actors.node.host import Reference, ask
from mlbs_actors.actors.node.pool import PoolPolicy
from mlbs_actors.actors.node.processes import get, here, wait
from mlbs_actors.actors.node.reservation import Reservation, Share
from mlbs_actors.actors.parts import PartFactory
from mlbs_actors.actors.pipeline import Node, StreamActors
from mlbs_actors.actors.stream.protocol import RunningStream, StreamProgress, StreamSpec
from mlbs_actors.errors import ConfigError, MlbsError, NoPlaceError
from mlbs_actors.source import FrameReader

__all__ = ["Cluster"]

#: Interval of checks for new and lost nodes, s.
_LOOK_SECONDS = 2.0

#: Timeout for the answer of a node, s: its first answer needs a new process.
_ANSWER_SECONDS = 60.0

#: How long Ray may take to reserve a share before that is reported, s.
_GRANT_SECONDS = 10.0


@dataclass(slots=True, eq=False)
class _Member:
    """A node that takes streams.

    ``share`` is that of one stream, ``next`` the reservation for the next one, if one waits.
    """

    name: str
    node: Node
    places: int
    share: Share
    running: int = 0
    next: Reservation | None = None

    @property
    def room(self) -> int:
        return self.places - self.running

    @property
    def is_ready(self) -> bool:
        """Whether the next stream can start here."""
        return self.next is not None and self.next.granted

    @property
    def is_late(self) -> bool:
        """Whether Ray should have reserved the next stream's share by now."""
        return self.next is not None and time.monotonic() - self.next.since > _GRANT_SECONDS


class Cluster:
    """The usable nodes of the cluster that was joined; a :class:`StreamHost`.

    Parameters
    ----------
    places : callable
        Run on each node, with its number of CPUs: returns how many streams it can hold, or raises an
        MlbsError that says why it can hold none.
    share : Share
        What a stream takes of a node that is large enough.
    say : callable
        Receives a message when a node joins, is lost or cannot be used.
    parts : PartFactory, optional
    policy : PoolPolicy, optional
        As for :class:`Node`.

    Raises
    ------
    ConfigError
        If there are nodes, but none that can be used. Without any, streams wait until one joins.
    """

    def __init__(
        self,
        places: Callable[[float], int],
        share: Share,
        say: Callable[[str], None],
        *,
        parts: PartFactory | None = None,
        policy: PoolPolicy | None = None,
    ) -> None:
        self._places = places
        self._share = share
        self._say = say
        self._parts = parts
        self._policy = policy or PoolPolicy()
        self._own = here()
        self._demand = Demand(self._own)
        self._members: dict[str, _Member] = {}
        self._asked: dict[str, Reference] = {}
        self._seen: set[str] = set()
        self._refused = 0
        self._shortage_known = False
        self._looked = float("-inf")
        self._changing = Lock()
        self._look(_ANSWER_SECONDS)
        if self._refused and not self._members and not self._asked:
            raise ConfigError("No node of the cluster can be used; the messages above say why.")

    @property
    def all_places(self) -> int:
        """How many streams the known nodes can hold."""
        return sum(member.places for member in self._members.values())

    def places(self, waiting: int) -> int:
        """Return how many streams may run by now, and reserve shares of nodes for more.

        Parameters
        ----------
        waiting : int
            Streams that wait for a place.
        """
        with self._changing:
            self._look(0.0)
            for node, member in self._members.items():
                if not waiting or member.room <= 0:
                    self._drop_next(member)
                elif member.next is None:
                    member.next = Reservation(member.share, node)
            running = sum(member.running for member in self._members.values())
            self._demand.tell(self._needed(running + waiting))
            ready = sum(member.is_ready for member in self._members.values())
            stuck = waiting > 0 and not ready
            self._shortage_known = stuck and (self._shortage_known or self._report_shortage())
            return running + ready

    def start(self, spec: StreamSpec, before: RunningStream | None = None) -> RunningStream:
        """Start a stream on its former node, else on the one with most room among those with its file.

        Raises
        ------
        NoPlaceError
            If there is no node.
        """
        with self._changing:
            self._look(0.0)
            if isinstance(before, _Placed) and before.place in self._members.values():
                member, earlier, reservation = before.place, before.stream, before.reservation
            else:
                members = self._members if spec.path is None else self._with_file(spec.path)
                if not members:
                    raise NoPlaceError("No node of the cluster takes streams; add one.")
                chosen = max(
                    members,
                    key=lambda node: (members[node].is_ready, members[node].room, node == self._own),
                )
                member, earlier = members[chosen], None
                reservation, member.next = member.next or Reservation(member.share, chosen), None
            member.running += 1
        granted = reservation if reservation.granted else None
        return _Placed(member.node.start(spec, earlier, reservation=granted), member, reservation)

    def repair(self) -> None:
        """Drop lost nodes, and repair the others; streams that were there must be started again."""
        with self._changing:
            # Ray notices the loss of a node late; the lack of an answer shows it at once.
            answers = {node: ask(_here, node=node) for node in self._members}
            for node in [node for node, answer in answers.items() if not _is_true(answer)]:
                self._lose(node)
            members = list(self._members.values())
        for member in members:
            member.node.repair()

    def close(self) -> None:
        """End the remaining processes on all nodes, and need no more of them."""
        self._demand.end()
        for member in self._members.values():
            self._drop_next(member)
            member.node.close()

    def _look(self, patience: float) -> None:
        """Update the list of nodes; wait up to this time for the answers of new ones, s."""
        if time.monotonic() - self._looked < _LOOK_SECONDS:
            return
        self._looked = time.monotonic()
        nodes: list[dict[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call]
        alive = {str(node["NodeID"]): node for node in nodes if node["Alive"]}
        for node in [node for node in self._members if node not in alive]:
            self._lose(node)
        for node in [node for node in alive if node not in self._seen]:
            self._seen.add(node)
            if cpus := _cpus(alive[node]):
                self._asked[node] = ask(partial(self._places, cpus), node=node)
            else:
                self._say(f"The node {_name(alive[node])} takes no streams, because Ray has no CPUs there.")
        if self._asked:
            asked = list(self._asked.values())
            answered, _ = wait(asked, least=len(asked), timeout=patience)
            for node in [node for node, answer in self._asked.items() if answer in answered]:
                answer = self._asked.pop(node)
                if node in alive:
                    self._admit(alive[node], answer)

    def _admit(self, node: dict[str, Any], answer: Reference) -> None:
        name, number = _name(node), str(node["NodeID"])
        try:
            places: int = get(answer)
        except RayError as error:
            self._refused += 1
            self._say(f"The node {name} is not used: {_refusal(error)}.")
            return
        share = Share(
            min(self._share.cpus, _cpus(node) / places),
            min(self._share.memory, int(node["Resources"].get("memory", 0)) // places),
        )
        policy = replace(self._policy, streams=places)
        actors = Node(number, parts=self._parts, policy=policy)
        self._members[number] = _Member(name, actors, places, share)
        self._say(f"The node {name} takes up to {places} of the streams.")

    def _lose(self, node: str) -> None:
        member = self._members.pop(node)
        self._drop_next(member)
        self._say(f"The node {member.name} is lost; its streams go on elsewhere.")

    def _drop_next(self, member: _Member) -> None:
        if member.next is not None:
            member.next.release()
            member.next = None

    def _needed(self, streams: int) -> list[Bundle]:
        """Return what there should be room for, by whole CPUs: Ray's autoscaler takes whole numbers only."""
        a_cpu: Bundle = {"CPU": 1, "memory": round(self._share.memory / self._share.cpus)}
        return [a_cpu] * ceil(streams * self._share.cpus)

    def _report_shortage(self) -> bool:
        """Report that streams wait for nodes or for other jobs; return False if they do not, or not yet."""
        late = [member.name for member in self._members.values() if member.is_late]
        if not self._members:
            self._say("No node takes streams; they wait until one joins the cluster.")
        elif late:
            nodes = " and ".join(f"the node {name}" for name in late)
            self._say(f"Streams wait: CPUs or memory of {nodes} are in use by others.")
        return bool(late) or not self._members

    def _with_file(self, path: Path) -> dict[str, _Member]:
        """Return the nodes where a file is; all if it is nowhere, so that the stream itself reports it."""
        if len(self._members) == 1:
            return self._members
        asked = {node: ask(path.exists, node=node) for node in self._members}
        return {node: self._members[node] for node in asked if _is_true(asked[node])} or self._members


class _Placed:
    """A running stream that frees its place on a node when it is stopped."""

    def __init__(self, stream: StreamActors, place: _Member, reservation: Reservation) -> None:
        self.stream = stream
        self.place = place
        self.reservation = reservation
        self._holds_place = True

    @property
    def node(self) -> str:
        return self.place.name

    def advance(self) -> Future[StreamProgress]:
        return self.stream.advance()

    def reopen(self, open_reader: Callable[[], FrameReader]) -> None:
        self.stream.reopen(open_reader)

    def configure(self, settings: object) -> None:
        self.stream.configure(settings)

    def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
        try:
            return self.stream.stop(drain=drain, returns=returns)
        finally:
            if self._holds_place:
                self.place.running -= 1
                self._holds_place = False
            if not returns:
                self.reservation.release()


def _cpus(node: dict[str, Any]) -> float:
    """Return how many CPUs Ray may use on a node; heads of clusters often have none."""
    return float(node["Resources"].get("CPU", 0.0))


def _name(node: dict[str, Any]) -> str:
    """Name a node by its address and, as several can have one, the start of its id."""
    return f"{node['NodeManagerAddress']} ({str(node['NodeID'])[:8]})"


def _refusal(error: RayError) -> str:
    """Say why a node cannot be used, and what to do."""
    if isinstance(cause := cause_of(error), MlbsError):
        return str(cause).rstrip(".")
    return (
        f"mlbs-actors cannot be loaded there ({last_line(error)}); install the same version of it into the "
        "Python that Ray runs in on that node"
    )


def _here() -> bool:
    """Answer from a node."""
    return True


def _is_true(answer: Reference) -> bool:
    """Whether an answer is true; False if there is none."""
    try:
        return bool(get(answer, _ANSWER_SECONDS))
    except (RayError, GetTimeoutError):
        return False
