"""Streams that a program starts in the Ray session that it has."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import ray
from actor_fakes import RaySession, wait_until

import orchestrator
from mlbs_actors import MultilayerSubtractor
from mlbs_actors.errors import ConfigError
from mlbs_actors.scenes.synthetic import scene_from_uri
from orchestrator import StreamResult

pytestmark = [pytest.mark.ray, pytest.mark.long]

SCENE = "synthetic:demo?frames=72&width=160&height=120&seed=1"


def processes_of_ours(title: str) -> Iterator[int]:
    """Yield the processes with such a title that descend from this one."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            command = (folder / "cmdline").read_text()
        except OSError:
            continue
        if command.startswith(title) and os.getpid() in _ancestors(int(folder.name)):
            yield int(folder.name)


def _ancestors(process: int) -> Iterator[int]:
    while process > 1:
        stat = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
        process = int(stat.rpartition(")")[2].split()[1])
        yield process


def _cpus(resources: Callable[[], dict[str, float]]) -> float:
    return resources().get("CPU", 0.0)


def test_streams_of_an_existing_session_survive_the_loss_of_a_layer_and_leave_the_session_alone(
    ray_session: RaySession,
) -> None:
    async def results() -> list[StreamResult]:
        taken: list[StreamResult] = []
        async with orchestrator.start({"a": SCENE, "b": SCENE}) as run:
            async for result in run:
                if not taken:
                    for process in processes_of_ours("ray::LayerActor"):
                        os.kill(process, signal.SIGKILL)
                taken.append(result)
            assert {state.state for state in run.status().values()} == {"done"}
        return taken

    taken = asyncio.run(results())
    scene = scene_from_uri(SCENE)
    expected = [
        result
        for _, result in MultilayerSubtractor().segment(scene.frame(index) for index in range(len(scene)))
    ]
    for name in ("a", "b"):
        own = [result for result in taken if result.stream == name]
        assert [result.frame for result in own] == list(range(72))
        assert all(np.array_equal(one.labels, two.labels) for one, two in zip(own, expected, strict=True))
    assert ray.is_initialized()
    wait_until(lambda: _cpus(ray.available_resources) == _cpus(ray.cluster_resources))


def test_a_task_gets_a_result_by_its_reference(ray_session: RaySession) -> None:
    @ray.remote(num_cpus=0)
    def size(result: StreamResult) -> tuple[int, ...]:
        return result.labels.shape

    with orchestrator.start([SCENE], max_frames=8, references=True) as run:
        assert ray.get([size.remote(one) for one in run]) == [(120, 160)] * 8


def test_an_address_is_refused_where_there_is_a_session(ray_session: RaySession) -> None:
    with pytest.raises(ConfigError, match="leave out address"):
        orchestrator.start([SCENE], address="auto")
