"""Time the engine and its peers alternately on the same frames, so that other load affects all of them alike.

Everything is in this process and in one thread. Only the ratios of one run mean much: another run, or another
machine, has other times.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from benchmark.in_process.peers import Peer
from mlbs_actors import Config, MultilayerSubtractor, Result
from mlbs_actors.determinism import single_threaded
from mlbs_actors.messages import Array
from orchestrator.evaluation.sequence_scorer import SequenceScore, SequenceScorer
from orchestrator.evaluation.sequences import Sequence

__all__ = ["ENGINE", "Measurement", "frame_order", "measure"]

T = TypeVar("T")

#: Names the engine's own row.
ENGINE = "mlbs-actors"


@dataclass(frozen=True, slots=True)
class Measurement:
    """One method on one sequence.

    Attributes
    ----------
    method : str
        :data:`ENGINE`, or a peer's name.
    wall_ms, cpu_ms : float
        Median wall time and mean CPU time of a frame in steady state, ms.
    stage_ms : dict of str to float
        Wall time of the engine's stages, mean of all frames in steady state, ms; empty for a peer.
    score : SequenceScore
        Of the first pass over the sequence.
    """

    method: str
    wall_ms: float
    cpu_ms: float
    stage_ms: Mapping[str, float]
    score: SequenceScore


def frame_order(length: int, frames: int) -> list[int]:
    """Return the indices of a sequence that is played back and forth without a cut.

    Parameters
    ----------
    length : int
        Frames of the sequence.
    frames : int
        How many to play.

    Returns
    -------
    list of int
    """
    back_and_forth = [*range(length), *range(length - 2, 0, -1)]
    return [back_and_forth[index % len(back_and_forth)] for index in range(frames)]


@dataclass(slots=True)
class _Clock:
    """Times of one method, frame by frame, s."""

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)


def measure(
    sequence: Sequence, peers: Mapping[str, Callable[[], Peer]], config: Config, frames: int, warm: int
) -> list[Measurement]:
    """Give every frame to the engine and then to each peer.

    Parameters
    ----------
    sequence : Sequence
    peers : mapping
        Name → what makes the peer.
    config : Config
        The engine's.
    frames : int
        Frames to play; the sequence is played back and forth.
    warm : int
        How many of them, at the start, are not timed: compilation, first clustering. Less than ``frames``.

    Returns
    -------
    list of Measurement
        The engine's first.

    Notes
    -----
    A peer needs two frames for a motion, so all are scored from the second frame on.
    """
    length = len(sequence.stems)
    engine = MultilayerSubtractor(config)
    others = {name: make() for name, make in peers.items()}
    clocks = {name: _Clock() for name in (ENGINE, *others)}
    scorers = {name: SequenceScorer() for name in clocks}
    stages: dict[str, list[float]] = {}

    def take(results: list[Result]) -> None:
        for result in results:
            _score(scorers[ENGINE], sequence, result.frame_index, result.labels)
            if result.frame_index >= warm:
                for stage, duration in result.stage_ms.items():
                    stages.setdefault(stage, []).append(duration)

    with single_threaded():
        for played, index in enumerate(frame_order(length, frames)):
            frame = sequence.frame(index)
            take(_timed(clocks[ENGINE], engine.apply, frame))
            for name, peer in others.items():
                mask = _timed(clocks[name], peer.apply, frame)
                _score(scorers[name], sequence, played, mask.astype(np.uint16))
        take(engine.flush())
    return [
        Measurement(
            name,
            1e3 * statistics.median(clock.wall[warm:]),
            1e3 * statistics.fmean(clock.cpu[warm:]),
            {stage: sum(durations) / max(frames - warm, 1) for stage, durations in stages.items()}
            if name == ENGINE
            else {},
            scorers[name].score(),
        )
        for name, clock in clocks.items()
    ]


def _timed(clock: _Clock, work: Callable[[Array], T], frame: Array) -> T:
    wall, cpu = time.perf_counter(), time.process_time()
    result = work(frame)
    clock.wall.append(time.perf_counter() - wall)
    clock.cpu.append(time.process_time() - cpu)
    return result


def _score(scorer: SequenceScorer, sequence: Sequence, played: int, labels: Array) -> None:
    if 0 < played < len(sequence.stems):
        scorer.add(played, labels, sequence.truth(played), None)
