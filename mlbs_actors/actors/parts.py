"""The interface between the actors and the engine's parts.

The actors know the engine through :class:`PartFactory` only. :class:`EngineParts` is the engine.
"""

from __future__ import annotations

import os
import tempfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from filelock import FileLock, Timeout

from mlbs_actors.config import Config
from mlbs_actors.kernels.machine_code import compiled_mark
from mlbs_actors.messages import (
    Array,
    FrameEvidence,
    LayerAppearance,
    LayerKind,
    LayerPosterior,
    Segmentation,
)
from mlbs_actors.stored_motion import StoredMotion

__all__ = [
    "CoordinatorPart",
    "EngineParts",
    "LayerPart",
    "PartFactory",
    "SegmenterPart",
]


#: How long a process waits for another one that compiles the same kernels, s; it can take minutes.
COMPILE_SECONDS = 300.0


class CoordinatorPart(Protocol):
    """Tracks, clusters and decides on layers.

    Attributes
    ----------
    state : dataclass
        Everything that determines its next frame, as of every part. Another one of its type moves the part to
        another frame.
    """

    state: Any

    def feedback_index(self, frame_index: int) -> int | None:
        """Return the frame whose Segmentation :meth:`step` will read, None for none."""

    def step(
        self,
        frame_index: int,
        frame: Array,
        feedback: Callable[[], Segmentation] | None,
        concealed: bool = False,
    ) -> list[FrameEvidence]:
        """Take the next frame; return the evidence complete by now, in frame order.

        The label map of ``feedback`` may be computed in parallel until that is called. ``concealed`` is
        whether the frame is known to be damaged.
        """

    def begin_anew(self) -> list[FrameEvidence]:
        """Return the evidence of the frames still held, and go on as with another scene."""

    def flush(self) -> list[FrameEvidence]:
        """Return the evidence of the frames still held, at the end of the stream."""


class LayerPart(Protocol):
    """Motion, appearance and prior of one layer."""

    state: Any

    def step(self, evidence: FrameEvidence, previous: Segmentation | None) -> LayerPosterior:
        """Finish frame t−1 with its labels, then predict and evaluate frame t."""

    def appearance(self) -> LayerAppearance:
        """Return the remembered colours at the frame evaluated last, without changing anything."""


class SegmenterPart(Protocol):
    """Normalises, cuts and cleans."""

    state: Any

    def step(self, evidence: FrameEvidence, frame: Array, posteriors: list[LayerPosterior]) -> Segmentation:
        """Label frame t from the posteriors of its layers, in ascending layer id."""


class PartFactory(Protocol):
    """Makes the parts inside the actor processes; picklable."""

    def coordinator(
        self, config: Config, ignored: Array | None = None, motion: StoredMotion | None = None
    ) -> CoordinatorPart:
        """Make a stream's coordinator; ``ignored`` is a mask of what is fixed in the picture.

        ``motion`` takes the place of the engine's own.
        """

    def layer(self, config: Config, layer: int, kind: LayerKind) -> LayerPart:
        """Make a layer."""

    def segmenter(self, config: Config) -> SegmenterPart:
        """Make a stream's segmenter."""

    def warm_coordinator(self) -> None:
        """Do in advance what would delay a stream's first frames in its coordinator."""

    def warm_segmenter(self) -> None:
        """Do so in its segmenter, where layers are born."""

    def warm_layer(self) -> None:
        """Do in advance what would delay the first frame of a layer in a process of its own."""


class EngineParts:
    """The engine of this package, imported only in the processes that run it."""

    def coordinator(
        self, config: Config, ignored: Array | None = None, motion: StoredMotion | None = None
    ) -> CoordinatorPart:
        """Make a stream's coordinator; ``ignored`` is a mask of what is fixed in the picture.

        ``motion`` takes the place of the engine's own.
        """
        from mlbs_actors.coordinator import Coordinator

        if motion is None:
            return Coordinator(config, ignored=ignored)
        return Coordinator(config, flow=motion.flow, ignored=ignored, tracks=motion.tracks)

    def layer(self, config: Config, layer: int, kind: LayerKind) -> LayerPart:
        """Make a layer."""
        from mlbs_actors.layer.layer import Layer

        return Layer(config, layer, kind)

    def segmenter(self, config: Config) -> SegmenterPart:
        """Make a stream's segmenter."""
        from mlbs_actors.segmentation.segmenter import Segmenter

        return Segmenter(config)

    def warm_coordinator(self) -> None:
        """See :func:`mlbs_actors.warm_up.warm_coordinator`."""
        from mlbs_actors.warm_up import warm_coordinator

        _warm(warm_coordinator)

    def warm_segmenter(self) -> None:
        """See :func:`mlbs_actors.warm_up.warm_segmenter`."""
        from mlbs_actors.warm_up import warm_segmenter

        _warm(warm_segmenter)

    def warm_layer(self) -> None:
        """See :func:`mlbs_actors.warm_up.warm_layer`."""
        from mlbs_actors.warm_up import warm_layer

        _warm(warm_layer)


def _warm(warm: Callable[[], None]) -> None:
    """Warm a process; of those that have something to compile, one after the other.

    The first one leaves its machine code on disk; all others would compile the same. If the lock fails, only
    time is lost. Low-priority processes have a lock of their own, so that others never wait for them.
    """
    done = compiled_mark(warm.__name__)
    if done.exists():
        warm()
        return
    rank = "-idle" if os.sched_getscheduler(0) == os.SCHED_IDLE else ""
    installation = zlib.crc32(str(Path(__file__).resolve()).encode())
    name = f"mlbs-actors-kernels-{os.getuid()}-{installation:08x}-{warm.__name__}{rank}.lock"
    lock = FileLock(Path(tempfile.gettempdir()) / name)
    with suppress(OSError, Timeout):
        lock.acquire(timeout=COMPILE_SECONDS)
    try:
        warm()
        with suppress(OSError):
            done.touch()
    finally:
        lock.release()
