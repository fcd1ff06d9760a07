"""Time the engine alone in this process, call by call, and keep what comes out of each call."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from mlbs_actors import Config, MultilayerSubtractor
from mlbs_actors.actors.node.process_memory import settle_memory
from mlbs_actors.determinism import single_threaded
from mlbs_actors.messages import Array

__all__ = ["EngineCall", "EngineCost", "play", "steady_cost"]


@dataclass(frozen=True, slots=True)
class EngineCall:
    """One call of the engine, with one frame.

    Attributes
    ----------
    wall_ms, cpu_ms : float
        Duration of the call, ms.
    objects : tuple of frozenset of int
        For each label map that came out, the objects in it.
    stage_ms : mapping of str to float
        Wall time by stage of the label maps that came out, ms.
    """

    wall_ms: float
    cpu_ms: float
    objects: tuple[frozenset[int], ...]
    stage_ms: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class EngineCost:
    """A frame in steady state.

    Attributes
    ----------
    wall_ms, cpu_ms : float
        Median wall time and mean CPU time, ms.
    objects : float
        Mean number of objects found.
    stage_ms : mapping of str to float
        Mean wall time by stage, ms.
    """

    wall_ms: float
    cpu_ms: float
    objects: float
    stage_ms: Mapping[str, float]


def play(frames: Iterable[Array], config: Config) -> list[EngineCall]:
    """Feed frames to a new engine, in one thread of a process that is set up as those of the pipeline are.

    Parameters
    ----------
    frames : iterable of (H, W, 3) uint8 BGR
        Produced outside the timed interval.
    config : Config
    """
    settle_memory()
    engine = MultilayerSubtractor(config)
    calls = []
    with single_threaded():
        for frame in frames:
            wall, cpu = time.perf_counter(), time.process_time()
            results = engine.apply(frame)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            stages: dict[str, float] = {}
            for result in results:
                for stage, duration in result.stage_ms.items():
                    stages[stage] = stages.get(stage, 0.0) + duration
            objects = tuple(frozenset(layer.layer for layer in result.layers) for result in results)
            calls.append(EngineCall(1e3 * wall, 1e3 * cpu, objects, stages))
    return calls


def steady_cost(calls: Sequence[EngineCall], warm: int) -> EngineCost:
    """Return the cost of a frame, without the first ``warm`` ones."""
    steady = calls[warm:]
    stages = dict.fromkeys(stage for call in steady for stage in call.stage_ms)
    counts = [len(objects) for call in steady for objects in call.objects]
    return EngineCost(
        statistics.median(call.wall_ms for call in steady),
        statistics.fmean(call.cpu_ms for call in steady),
        statistics.fmean(counts) if counts else 0.0,
        {stage: statistics.fmean(call.stage_ms.get(stage, 0.0) for call in steady) for stage in stages},
    )
