"""All nodes of a Ray cluster as one host of streams: each stream runs on one node, frames never leave it.

A node is checked once, before the first stream is placed on it: how many streams it can hold, and whether it
sees the shared folder. Nodes may join and be lost at any time; a stream whose node is lost is started again
by the driver, on another.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import Any

import ray
from ray.exceptions import GetTimeoutError, RayError

from mlbs_actors.actors.node.failures import last_line
from mlbs_actors.actors.node.pool import PoolPolicy
from mlbs_actors.actors.node.processes import Reference, ask
from mlbs_actors.actors.parts import PartFactory
from mlbs_actors.actors.pipeline import Node, StreamActors
from mlbs_actors.actors.stream.protocol import RunningStream, StreamProgress, StreamSpec
from mlbs_actors.errors import ActorLostError

__all__ = ["Cluster"]

#: Interval of checks for new and lost nodes, s.
_LOOK_SECONDS = 2.0

#: Timeout for the answer of a node, s: its first answer needs a new process.
_ANSWER_SECONDS = 60.0


@dataclass(slots=True)
class _Member:
    """A node that takes streams."""

    node: Node
    places: int
    running: int = 0

    @property
    def room(self) -> int:
        return self.places - self.running


class Cluster:
    """The usable nodes of the cluster that was joined; a :class:`StreamHost`.

    Parameters
    ----------
    places : callable
        Run on each node: returns how many streams it can hold, or raises an MlbsError that says why it can
        hold none.
    say : callable
        Receives a message when a node joins, is lost or cannot be used.
    parts : PartFactory, optional
    policy : PoolPolicy, optional
        As for :class:`Node`.
    """

    def __init__(
        self,
        places: Callable[[], int],
        say: Callable[[str], None],
        *,
        parts: PartFactory | None = None,
        policy: PoolPolicy | None = None,
    ) -> None:
        self._places = places
        self._say = say
        self._parts = parts
        self._policy = policy or PoolPolicy()
        self._own = ray.get_runtime_context().get_node_id()
        self._members: dict[str, _Member] = {}
        self._asked: dict[str, Reference] = {}
        self._seen: set[str] = set()
        self._looked = float("-inf")
        self._changing = Lock()
        self._look(_ANSWER_SECONDS)

    def places(self) -> int:
        """Return how many streams all nodes together can hold by now; at least 1."""
        with self._changing:
            self._look(0.0)
            return max(1, sum(member.places for member in self._members.values()))

    def start(self, spec: StreamSpec, before: RunningStream | None = None) -> RunningStream:
        """Start a stream where its reader lives, else on the node with most room among those with its file.

        Raises
        ------
        ActorLostError
            If no node can be used.
        """
        with self._changing:
            self._look(0.0)
            members = self._members if spec.path is None else self._with_file(spec.path)
            if not members:
                raise ActorLostError("No node of the cluster can be used; look at the messages above.")
            chosen = max(members, key=lambda node: (members[node].room, node == self._own))
            member, earlier = members[chosen], None
            if isinstance(before, _Placed) and before.reader_lives and before.place in members.values():
                member, earlier = before.place, before.stream
            member.running += 1
        return _Placed(member.node.start(spec, earlier), member)

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
        """End the remaining processes on all nodes."""
        for member in self._members.values():
            member.node.close()

    def _look(self, patience: float) -> None:
        """Update the list of nodes; wait up to this time for the answers of new ones, s."""
        if time.monotonic() - self._looked < _LOOK_SECONDS:
            return
        self._looked = time.monotonic()
        nodes: list[dict[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call]
        alive = {str(node["NodeID"]): str(node["NodeManagerAddress"]) for node in nodes if node["Alive"]}
        for node in [node for node in self._members if node not in alive]:
            self._lose(node)
        for node in alive.keys() - self._seen:
            self._seen.add(node)
            self._asked[node] = ask(self._places, node=node)
        if self._asked:
            asked = list(self._asked.values())
            answered, _ = ray.wait(asked, num_returns=len(asked), timeout=patience)
            for node in [node for node, answer in self._asked.items() if answer in answered]:
                self._admit(node, alive.get(node, "that was lost"), self._asked.pop(node))

    def _admit(self, node: str, address: str, answer: Reference) -> None:
        try:
            places: int = ray.get(answer)
        except RayError as error:
            self._say(f"The node {address} is not used: {last_line(error)}.")
            return
        policy = replace(self._policy, streams=places)
        self._members[node] = _Member(Node(node, parts=self._parts, policy=policy), places)
        self._say(f"The node {address} takes up to {places} of the streams.")

    def _lose(self, node: str) -> None:
        del self._members[node]
        self._say("A node of the cluster is lost; its streams go on elsewhere.")

    def _with_file(self, path: Path) -> dict[str, _Member]:
        """Return the nodes where a file is; all if it is nowhere, so that the stream itself reports it."""
        if len(self._members) == 1:
            return self._members
        asked = {node: ask(path.exists, node=node) for node in self._members}
        return {node: self._members[node] for node in asked if _is_true(asked[node])} or self._members


class _Placed:
    """A running stream that frees its place on a node when it is stopped."""

    def __init__(self, stream: StreamActors, place: _Member) -> None:
        self.stream = stream
        self.place = place
        self._holds_place = True

    @property
    def reader_lives(self) -> bool:
        return self.stream.living_reader is not None

    def advance(self) -> Future[StreamProgress]:
        return self.stream.advance()

    def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
        try:
            return self.stream.stop(drain=drain, returns=returns)
        finally:
            if self._holds_place:
                self.place.running -= 1
                self._holds_place = False


def _here() -> bool:
    """Answer from a node."""
    return True


def _is_true(answer: Reference) -> bool:
    """Whether an answer is true; False if there is none."""
    try:
        return bool(ray.get(answer, timeout=_ANSWER_SECONDS))
    except (RayError, GetTimeoutError):
        return False
