"""Streams on a cluster of one node, whose CPUs other jobs want, too."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import ray
from actor_fakes import FakeParts, FakeReader, RaySession, picture, run_to_end, spec, wait_until

from mlbs_actors.actors.node.cluster import Cluster
from mlbs_actors.actors.node.host import Handle
from mlbs_actors.actors.node.pool import PoolPolicy
from mlbs_actors.actors.node.processes import end
from mlbs_actors.actors.node.reservation import Share
from mlbs_actors.errors import ConfigError

pytestmark = pytest.mark.ray

SHARE = Share(0.75, 10 * 2**20)


class OtherJob:
    """An actor of somebody else."""


def two(cpus: float) -> int:
    """Return how many streams the tests' node takes, which has two CPUs."""
    return int(cpus)


def none(cpus: float) -> int:
    raise ConfigError("it is not to be used")


def free() -> float:
    resources = ray.available_resources()  # type: ignore[no-untyped-call]
    return float(resources.get("CPU", 0.0))


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def cluster(ray_session: RaySession, parts: FakeParts, said: list[str]) -> Iterator[Cluster]:
    cluster = Cluster(two, SHARE, said.append, parts=parts, policy=PoolPolicy(spare=1))
    yield cluster
    cluster.close()


def has(cluster: Cluster, places: int, waiting: int = 1) -> Callable[[], bool]:
    return lambda: cluster.places(waiting) == places


def test_a_stream_holds_its_share_of_the_node_until_it_ends(cluster: Cluster, tmp_path: Path) -> None:
    assert free() == 2.0
    wait_until(has(cluster, 1))
    stream = cluster.start(spec("one", FakeReader([picture(t, live=[1]) for t in range(20)], tmp_path)))
    wait_until(lambda: free() == 2.0 - SHARE.cpus)
    wait_until(has(cluster, 2))  # there is room for another one
    wait_until(has(cluster, 1, waiting=0))
    run_to_end(stream)
    wait_until(lambda: free() == 2.0)


def test_a_stream_waits_for_cpus_that_another_job_has(
    cluster: Cluster, said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mlbs_actors.actors.node.cluster._GRANT_SECONDS", 0.0)
    other: Handle = ray.remote(num_cpus=2)(OtherJob).remote()
    ray.get(other.__ray_ready__.remote())
    wait_until(lambda: cluster.places(1) == 0 and any("in use by others" in one for one in said))
    assert cluster.places(1) == 0
    assert sum("in use by others" in one for one in said) == 1
    end([other])
    wait_until(has(cluster, 1))


def test_a_cluster_without_a_usable_node_is_refused(
    ray_session: RaySession, said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # However long the node takes to answer.
    monkeypatch.setattr("mlbs_actors.actors.node.cluster._ANSWER_SECONDS", None)
    with pytest.raises(ConfigError, match="No node of the cluster can be used"):
        Cluster(none, SHARE, said.append)
    [reason] = said
    assert reason.endswith("is not used: it is not to be used.")
