"""Run by a test in a process of its own: streams on a Ray cluster that gains a node and loses another."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import ray
from ray.cluster_utils import Cluster as LocalCluster

from mlbs_actors import Config
from mlbs_actors.actors.node.cluster import Cluster
from mlbs_actors.actors.node.pool import PoolPolicy
from mlbs_actors.actors.node.reservation import Share
from mlbs_actors.actors.stream.protocol import StreamSpec
from orchestrator.interruption import Interruption
from orchestrator.run.admission import by_count
from orchestrator.run.driver import Driver
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.record import StreamRecord
from orchestrator.sources.address import parse_address
from orchestrator.sources.opening import open_reader

SCENE = "synthetic:demo?frames=120&width=160&height=120&seed={}"
STORE = 80 * 2**20


class Watch:
    """Sees two streams commit frames."""

    def __init__(self) -> None:
        self.under_way = threading.Event()

    def update(self, states: Sequence[StreamState]) -> None:
        if sum(state.committed >= 8 for state in states) >= 2:
            self.under_way.set()


def one(cpus: float) -> int:
    """Every node takes one stream."""
    return 1


def main(folder: Path) -> None:
    local = LocalCluster(initialize_head=True, head_node_args={"num_cpus": 1, "object_store_memory": STORE})
    victim = local.add_node(num_cpus=1, object_store_memory=STORE)
    ray.init(address=local.address, log_to_driver=False)
    said: list[str] = []
    host = Cluster(one, Share(0.5, 100 * 2**20), said.append, policy=PoolPolicy(spare=1))
    specs = [
        StreamSpec(
            f"s{number}",
            Config(),
            partial(open_reader, parse_address(SCENE.format(number), folder)),
            partial(StreamRecord, folder / f"s{number}", f"s{number}", frozenset({"masks"})),
        )
        for number in range(4)
    ]
    with Interruption() as interruption:
        watch = Watch()
        statuses: list[int] = []
        driver = Driver(
            specs,
            host,
            admission=by_count(host.places),
            observers=[watch],
            interruption=interruption,
        )
        driving = threading.Thread(target=lambda: statuses.append(driver.run()))
        driving.start()
        watch.under_way.wait()
        # Ray starts nodes in the main thread only.
        local.add_node(num_cpus=1, object_store_memory=STORE)
        while sum("takes up to" in one for one in said) < 3:
            time.sleep(0.1)
        local.remove_node(victim, allow_graceful=False)
        driving.join()
    host.close()
    outcome = [[state.name, state.state, state.committed, state.error] for state in driver.states]
    # Ray prints warnings of its own on standard output.
    (folder / "outcome.json").write_text(
        json.dumps({"status": statuses[0], "states": outcome, "said": said}), encoding="utf-8"
    )
    ray.shutdown()
    local.shutdown()  # type: ignore[no-untyped-call]


main(Path(sys.argv[1]))
