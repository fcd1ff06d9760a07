"""Which streams may run at once: as many as the machine holds, in the order of the list.

A stream is several processes, and together they must fit into memory: if a machine swaps, or its kernel kills
for memory, all streams are lost at once. Each stream is admitted with memory for a few objects; for more,
the pool starts processes while memory lasts (:mod:`mlbs_actors.actors.node.pool`). More streams than the
cores can serve only cost memory, so they are bounded too. The others wait and start as running ones end.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

from mlbs_actors.actors.node.memory import LAYER_BYTES, STREAM_BYTES, NodeMemory
from mlbs_actors.wording import count_of
from orchestrator.run.stream_state import ENDED, StreamState

__all__ = [
    "PLACE_BYTES",
    "STREAMS_A_CORE",
    "cores",
    "places",
    "streams_to_start",
    "warn_of_cameras",
]

#: Unique memory of a stream with four objects, bytes.
PLACE_BYTES = STREAM_BYTES + 4 * LAYER_BYTES

#: Left for the driver, Ray's own processes, the sink and the object store, bytes.
_RESERVED_BYTES = 1_500 * 2**20

#: Most streams for each core. A stream's stages wait for one another: two on a core keep it busy.
STREAMS_A_CORE = 2


def places(memory: NodeMemory, core_count: float) -> int:
    """Return how many streams may run at once.

    Parameters
    ----------
    memory : NodeMemory
        Before the run.
    core_count : float

    Returns
    -------
    int
        At least 1: a machine too small for the estimate may still hold one small stream.
    """
    by_memory = (memory.free - _RESERVED_BYTES) // PLACE_BYTES
    return max(1, min(by_memory, int(core_count * STREAMS_A_CORE)))


def warn_of_cameras(cameras: int, streams: int, limit: int) -> str | None:
    """Warn that some streams may never start if cameras, which do not end by themselves, take all places.

    Parameters
    ----------
    cameras : int
        Streams without an end.
    streams : int
        All streams, cameras included.
    limit : int
        Streams that may run at once.
    """
    if cameras < limit or streams <= limit:
        return None
    return (
        f"Cameras do not end by themselves and will hold all {limit} places of this machine; "
        f"{count_of(streams - limit, 'stream')} may never start. Leave some out, set --max-frames, or add "
        "machines with --address."
    )


def streams_to_start(states: Sequence[StreamState], limit: int) -> tuple[str, ...]:
    """Select the waiting streams that may start now, in the order of ``states``.

    Parameters
    ----------
    states : sequence of StreamState
    limit : int
        Streams that may run at once.
    """
    running = sum(state.state != "waiting" and state.state not in ENDED for state in states)
    waiting = (state.name for state in states if state.state == "waiting")
    return tuple(name for name, _ in zip(waiting, range(limit - running), strict=False))


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))
