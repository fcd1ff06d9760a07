"""What the streams of a run are started on, and what decides how many run at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mlbs_actors.actors.node.cluster import Cluster
from mlbs_actors.actors.node.memory import NodeMemory, node_memory
from mlbs_actors.actors.node.pool import PoolPolicy
from mlbs_actors.actors.node.reservation import Share
from mlbs_actors.actors.pipeline import Node
from orchestrator.run.admission import Admission, by_count, by_load, cores, places, places_by_memory
from orchestrator.run.need import Need
from orchestrator.run.node_check import node_places
from orchestrator.run.versions import installed_versions

__all__ = ["Room", "admission_to", "host_of"]

#: What a user who limits the streams is told that they wait for.
_PLACES = "places (--places or --reserve)"


@dataclass(frozen=True, slots=True)
class Room:
    """What a run has, and what each of its streams needs.

    Attributes
    ----------
    memory : NodeMemory
        Of this machine before the run.
    need : Need
    """

    memory: NodeMemory
    need: Need

    @property
    def places(self) -> int:
        """How many streams of files may run on this machine at once."""
        return places(self.memory, cores(), self.need)

    @property
    def places_by_memory(self) -> int:
        """How many streams fit into its memory."""
        return places_by_memory(self.memory, self.need)


def host_of(
    folder: Path, streams: int, need: Need, say: Callable[[str], None], *, shared: bool
) -> Node | Cluster:
    """Return what streams are started on in the present Ray session.

    Parameters
    ----------
    folder : Path
        The run's, which has been created.
    streams : int
        For how many memory is reserved in a session of the run's own.
    need : Need
        Of each.
    say : callable
        Receives messages about nodes.
    shared : bool
        Whether others use the session, too: then each stream reserves what it takes with Ray.

    Raises
    ------
    ConfigError
        If no node of a shared session can be used.
    """
    if not shared:
        return Node(policy=PoolPolicy(streams=streams))
    check = partial(node_places, folder, installed_versions(), need)
    return Cluster(check, Share(need.cpus, need.memory), say)


def admission_to(host: Node | Cluster, room: Room, most: int | None = None) -> Admission:
    """Return what decides which streams may run.

    Parameters
    ----------
    host : Node or Cluster
        From :func:`host_of`.
    room : Room
    most : int, optional
        As many as the user allows, whatever they take.
    """
    if isinstance(host, Cluster):
        if most is None:
            return by_count(host.places, "places of the nodes", lambda: host.all_places)
        return by_count(lambda waiting: min(most, host.places(waiting)), _PLACES)
    if most is None:
        return by_load(cores(), room.places, node_memory)
    return by_count(most, _PLACES)
