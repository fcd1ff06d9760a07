"""Statistics of a stream: what its source has delivered, and how long the work on it takes."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping

from mlbs_actors.actors.stream.protocol import StreamProgress
from mlbs_actors.messages import Segmentation
from mlbs_actors.source import SourceFrame, SourcePosition, SourceSilence, SourceStatus

__all__ = ["StreamAccount"]


class StreamAccount:
    """Counts of a stream's source and times of its label maps, for snapshots and progress reports.

    Parameters
    ----------
    most_frames : int, optional
        Label maps after which the stream ends.

    Attributes
    ----------
    counts : Counter of str
        Frames taken from the source, by their status.
    position : SourcePosition
        Of the last one.
    silence : SourceSilence, optional
        The source's last answer, if that was no frame.
    problem : str, optional
        Why the stream is incomplete.
    """

    def __init__(self, most_frames: int | None) -> None:
        self._most_frames = most_frames
        self.counts: Counter[SourceStatus] = Counter()
        self.position = SourcePosition()
        self.silence: SourceSilence | None = None
        self.problem: str | None = None
        self._length: int | None = None  # as stated by the source
        self._stage_sums: dict[str, float] = {}
        self._labelled = 0
        self._objects = 0  # in the newest label map

    def restore(self, counts: Mapping[SourceStatus, int], position: SourcePosition) -> None:
        """Go back to a snapshot."""
        self.counts.update(counts)
        self.position = position

    def take(self, frame: SourceFrame | SourceSilence) -> None:
        """Count a frame of the source, or remember its silence."""
        if isinstance(frame, SourceSilence):
            self.silence = frame
            return
        self.silence = None
        self.counts[frame.status] += 1
        self.position = SourcePosition(self.counts.total(), frame.pts, time.time())
        self._length = frame.length

    def label(self, segmentation: Segmentation) -> None:
        """Add the stage times of a label map, and count its objects."""
        self._labelled += 1
        self._objects = len({layer.object for layer in segmentation.layers})
        for stage, milliseconds in segmentation.stage_ms.items():
            self._stage_sums[stage] = self._stage_sums.get(stage, 0.0) + milliseconds

    @property
    def read(self) -> int:
        """Frames taken from the source, without gaps."""
        return self.counts.total() - self.counts["gap"]

    def progress(self, committed: int, layers: int, *, done: bool, kept_waiting: bool) -> StreamProgress:
        """Report the counts, with the mean times of the label maps since the last report."""
        lengths = [] if self._length is None else [self._length]
        if self._most_frames is not None:
            lengths.append(self._most_frames + self.read - self.counts["ok"])
        means = {stage: total / self._labelled for stage, total in self._stage_sums.items()}
        self._stage_sums, self._labelled = {}, 0
        return StreamProgress(
            read=self.read,
            committed=committed,
            quarantined=self.counts["quarantined"],
            dropped=self.counts["dropped"],
            gaps=self.counts["gap"],
            layers=layers,
            done=done,
            problem=self.problem,
            stage_ms=means,
            silence=self.silence,
            length=min(lengths, default=None),
            kept_waiting=kept_waiting,
            objects=0 if done else self._objects,
        )
