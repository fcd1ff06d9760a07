"""Settings that all measurements of one run of the benchmark share."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmark.in_process.comparison import frame_order
from benchmark.through_ray.endless_video import write_video
from mlbs_actors import Config
from mlbs_actors.messages import Array
from orchestrator.evaluation.sequences import Sequence

__all__ = ["Settings", "report_progress"]


@dataclass(frozen=True)
class Settings:
    """How to measure, and on which sequences.

    Attributes
    ----------
    sequences : mapping of str to Sequence
        Those that were asked for, by name.
    config : Config
        The engine's.
    frames : int
        Frames to play.
    warm : int
        How many of them, at the start, are not timed.
    folder : Path
        For the measurement's own files.
    """

    sequences: Mapping[str, Sequence]
    config: Config
    frames: int
    warm: int
    folder: Path

    @property
    def steady(self) -> int:
        """Return the number of frames that are timed."""
        return self.frames - self.warm

    def played(self, sequence: Sequence) -> Iterator[Array]:
        """Yield the frames to play, back and forth, one at a time."""
        return (sequence.frame(index) for index in frame_order(len(sequence.stems), self.frames))

    def endless_video(self, name: str) -> Path:
        """Write a sequence, once forward and back, as a video file that can be looped without a cut."""
        path = self.folder / f"{hashlib.sha256(name.encode()).hexdigest()}.mp4"
        if not path.exists():
            report_progress(f"{name}: writing it as a video")
            sequence = self.sequences[name]
            length = len(sequence.stems)
            pictures = [sequence.frame(index) for index in range(length)]
            write_video((pictures[index] for index in frame_order(length, max(1, 2 * length - 2))), path)
        return path


def report_progress(text: str) -> None:
    """Report on standard error what is being measured, and how far it is."""
    print(text, file=sys.stderr, flush=True)
