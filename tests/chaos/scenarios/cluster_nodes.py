"""Lose a node of a cluster, and give it one that lacks the package."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmark.through_ray.process_costs import process_tree
from chaos.harness.fault_series import LABELLED, newest_label_map, time_recovery
from chaos.harness.injection import Injector
from chaos.harness.observed_run import ObservedRun, expect
from chaos.harness.scenario import (
    FRAMES,
    LINES,
    RecoveryTime,
    ScenarioContext,
    bystander,
    expect_end,
    expect_identical,
    single_fault,
    victim,
)

__all__ = ["SCENARIOS"]

#: Length of streams that go on while nodes are waited for, frames.
_LONG = 8 * FRAMES

#: In each Python process with it on the path, our packages are missing.
_WITHOUT_PACKAGE = """\
import importlib.abc
import sys

class Missing(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("mlbs_actors", "orchestrator"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
"""


def _node_lost(context: ScenarioContext) -> RecoveryTime:
    """Remove one of a cluster's three nodes that has a stream, which is restored on another one."""
    lines = victim(_LONG), bystander(_LONG)
    context.prepare(lines)
    injector = Injector(context.folder / "injector", [LABELLED])
    with _first_on_path(context.folder / "injector"), _cluster(head_cpus=1) as cluster:
        nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
        with ObservedRun(lines, context.folder, "--address", cluster.address, injector=injector) as run:
            run.wait_for_frames("victim", int(context.random.integers(8, FRAMES)))
            run.wait_for_frames("bystander", int(context.random.integers(8, FRAMES)))
            newest = {name: newest_label_map(run.output / name) for name in ("victim", "bystander")}
            busy = [node for node in nodes if _has_a_stream(node)]
            expect(bool(busy), "not injected: no stream is on a node that can be lost")
            began = time.monotonic()
            cluster.remove_node(busy[int(context.random.integers(len(busy)))], allow_graceful=False)
            back = time_recovery(run, injector, began, newest, lambda: _returned(run))
            expect_end(run, 0)
            expect_identical(context, run, *lines)
            return back


def _node_without_package(context: ScenarioContext) -> None:
    """Run on a node that lacks the package, which is refused; then on that one and another one."""
    blocking = context.folder / "blocking"
    blocking.mkdir(parents=True)
    (blocking / "sitecustomize.py").write_text(_WITHOUT_PACKAGE, encoding="utf-8")
    with _cluster(head_cpus=0) as cluster:
        with _first_on_path(blocking):
            cluster.add_node(num_cpus=2)
        with ObservedRun(LINES, context.folder / "refused", "--address", cluster.address) as run:
            stderr = expect_end(run, 2)
            expect("No node of the cluster can be used" in stderr, f"the refusal is not reported: {stderr}")
        cluster.add_node(num_cpus=1)
        with ObservedRun(LINES, context.folder / "used", "--address", cluster.address) as run:
            stderr = expect_end(run, 0)
            expect("mlbs-actors cannot be loaded there" in stderr, f"the node is not reported: {stderr}")
            expect_identical(context, run)


@contextmanager
def _cluster(head_cpus: int) -> Iterator[Any]:
    """Start a cluster with a head; end it and all its nodes afterwards."""
    from ray.cluster_utils import Cluster

    head = {"num_cpus": head_cpus, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    try:
        yield cluster
    finally:
        cluster.shutdown()  # type: ignore[no-untyped-call]


@contextmanager
def _first_on_path(folder: Path) -> Iterator[None]:
    """Put a folder first on the path of the Python processes that are started in the ``with`` block."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(folder), before]))
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before


def _has_a_stream(node: Any) -> bool:
    """Return whether a node of Ray's cluster for tests has processes of a stream."""
    raylet = node.all_processes["raylet"][0].process.pid
    return any(one.title.startswith("ray::SegmenterActor") for one in process_tree(raylet).values())


def _returned(run: ObservedRun) -> set[str]:
    return {name for name, stream in run.status().items() if stream["returns"]}


SCENARIOS = (
    single_fault("18", "a node of three lost with its stream", _node_lost),
    single_fault("30", "a node without the package", _node_without_package),
)
