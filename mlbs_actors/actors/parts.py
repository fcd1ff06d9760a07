"""What the actors run: the pure parts of the engine, named by what the actors need of them.

The actors know the engine through :class:`PartFactory` only. :class:`EngineParts` is the engine.
"""

from __future__ import annotations

import os
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from filelock import FileLock, Timeout

from mlbs_actors.config import Config
from mlbs_actors.messages import (
    Array,
    FrameEvidence,
    LayerAppearance,
    LayerKind,
    LayerPosterior,
    LayerTracks,
    Segmentation,
    received,
)

__all__ = [
    "CoordinatorPart",
    "EngineParts",
    "LayerPart",
    "PartFactory",
    "SegmenterPart",
]


#: How long a process waits for another one that compiles the same, s; on a slow machine that takes minutes.
TURN_SECONDS = 300.0


class CoordinatorPart(Protocol):
    """Tracks, clusters and decides on layers.

    Attributes
    ----------
    state : dataclass
        As of every part: all that steers its next frame. Another one of its type takes the part to another
        frame.
    """

    state: Any

    def feedback_index(self, frame_index: int) -> int | None:
        """Return the frame whose Segmentation :meth:`step` will read, None for none."""

    def step(
        self, frame_index: int, frame: Array, feedback: Callable[[], Segmentation] | None
    ) -> list[FrameEvidence]:
        """Take the next frame; return the evidence complete by now, in frame order.

        What makes the label map that ``feedback`` returns may be at work until that is called.
        """

    def flush(self) -> list[FrameEvidence]:
        """Return the evidence of the frames still held, at the end of the stream."""


class LayerPart(Protocol):
    """Motion, appearance and prior of one layer."""

    state: Any

    def step(self, evidence: FrameEvidence, frame: Array, previous: Segmentation | None) -> LayerPosterior:
        """Finish frame t−1 with its labels, then predict and evaluate frame t."""

    def appearance(self) -> LayerAppearance:
        """Return what is remembered at the frame evaluated last; nothing is changed."""


class SegmenterPart(Protocol):
    """Normalises, cuts and cleans."""

    state: Any

    def step(self, evidence: FrameEvidence, frame: Array, posteriors: list[LayerPosterior]) -> Segmentation:
        """Label frame t from the posteriors of its layers, in ascending layer id."""


class PartFactory(Protocol):
    """Makes the parts inside the actor processes; picklable."""

    def coordinator(self, config: Config) -> CoordinatorPart:
        """Make a stream's coordinator."""

    def layer(self, config: Config, layer: int, kind: LayerKind) -> LayerPart:
        """Make a layer."""

    def segmenter(self, config: Config) -> SegmenterPart:
        """Make a stream's segmenter."""

    def warm_layer(self) -> None:
        """Do once what would delay the first frame of a layer, in a process that waits for one."""

    def warm_stream(self) -> None:
        """Do once what would delay a stream's start, in a process that waits for one."""


class EngineParts:
    """The engine of this package, imported only in the processes that run it."""

    def coordinator(self, config: Config) -> CoordinatorPart:
        """Make a stream's coordinator."""
        from mlbs_actors.coordinator import Coordinator

        return Coordinator(config)

    def layer(self, config: Config, layer: int, kind: LayerKind) -> LayerPart:
        """Make a layer."""
        from mlbs_actors.layer.layer import Layer

        return Layer(config, layer, kind)

    def segmenter(self, config: Config) -> SegmenterPart:
        """Make a stream's segmenter."""
        from mlbs_actors.segmentation.segmenter import Segmenter

        return Segmenter(config)

    def warm_layer(self) -> None:
        """Run two layers over two small frames, so that their kernels are compiled or loaded.

        The arrays are read-only, as those of real frames are when they arrive: for Numba that is another
        type, with kernels of its own. Processes of one machine do it one after the other: the first ever
        compiles for most of a minute and leaves its kernels on disk, where the others would all compile the
        same.
        """
        import mlbs_actors.layer.layer  # noqa: F401  (needs no turn)

        with _turn("layer"):
            self._run_two_layers()

    def warm_stream(self) -> None:
        """Label a small scene with objects, so that the kernels of all parts are compiled or loaded.

        Else those that only objects need are loaded at a stream's first birth: a quarter of a second. What
        a scene holds by accident only (a label that may be removed, a contact shadow, a crowd) comes after
        it. Where nothing is compiled yet, a process for layers compiles theirs meanwhile.
        """
        import mlbs_actors.coordinator
        import mlbs_actors.segmentation.segmenter  # noqa: F401  (need no turn)

        with _turn("stream"):
            self._label_small_scene()
            _cut_images()
            _find_contact_shadow()
            _publish_again()
            _focus_on_crowd()

    def _run_two_layers(self) -> None:
        config = Config()
        height, width = 480, 640
        grid = (height // 2, width // 2)  # of the cells, and of the flow
        random = np.random.default_rng(0)
        frame = _read_only(random.integers(0, 256, (height, width, 3), dtype=np.uint8))
        columns, rows = np.meshgrid(np.arange(140, 180, 8), np.arange(100, 140, 8))
        count = columns.size  # of each layer's trajectories, which are at the same places
        positions = np.tile(np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float32), (2, 1))
        motions = random.normal(size=positions.shape).astype(np.float32)  # so that there is a field to solve
        kinds: tuple[LayerKind, ...] = ("background", "object")
        for layer, kind in enumerate(kinds):  # one works on the frame, the other on a piece of it
            part = self.layer(config, layer, kind)
            previous = None
            for t in range(2):
                tracks = tuple(
                    LayerTracks(one, kinds[one], t - 1, one * count, (one + 1) * count) for one in range(2)
                )
                evidence = FrameEvidence(
                    frame_index=t,
                    shape=(height, width),
                    camera=np.eye(3),
                    flow=np.zeros((*grid, 2), np.float32),
                    flow_reliable=np.ones(grid, bool),
                    unexplained=np.full(grid, 255, np.uint8),
                    tracks=tracks,
                    positions=positions,
                    motions=motions,
                    retired=(),
                    latency_frames=0,
                )
                part.step(received(evidence), frame, previous)
                segmentation = Segmentation(
                    frame_index=t,
                    labels=np.full((height, width), layer, np.uint16),
                    normaliser=np.zeros(grid, np.uint8),
                    fallback=np.zeros(grid, np.int8),
                    layers=(),
                    camera_motion=(0.0, 0.0),
                    latency_frames=0,
                )
                previous = received(segmentation)

    def _label_small_scene(self) -> None:
        coordinator, segmenter = self.coordinator(Config()), self.segmenter(Config())
        layers: dict[int, LayerPart] = {}
        made: list[Segmentation] = []
        for t, frame in enumerate(_small_scene()):
            wanted = coordinator.feedback_index(t)
            feedback = None if wanted is None else partial(made.__getitem__, wanted)
            for evidence in map(received, coordinator.step(t, frame, feedback)):
                previous = made[-1] if made else None
                posteriors = []
                for own in evidence.tracks:
                    if own.layer not in layers:
                        layers[own.layer] = self.layer(Config(), own.layer, own.kind)
                    posterior = layers[own.layer].step(evidence, frame, previous)
                    posteriors.append(received(posterior))
                made.append(received(segmenter.step(evidence, frame, posteriors)))


@contextmanager
def _turn(warmed: str) -> Iterator[None]:
    """Wait for this user's other processes of this installation that do the same; without order nothing is
    lost but time.

    Those that step back take turns among themselves: who is waited for must not wait for them.
    """
    rank = "-idle" if os.sched_getscheduler(0) == os.SCHED_IDLE else ""
    installation = zlib.crc32(str(Path(__file__).resolve()).encode())
    name = f"mlbs-actors-kernels-{os.getuid()}-{installation:08x}-{warmed}{rank}.lock"
    lock = FileLock(Path(tempfile.gettempdir()) / name)
    with suppress(OSError, Timeout):
        lock.acquire(timeout=TURN_SECONDS)
    try:
        yield
    finally:
        lock.release()


def _small_scene(frames: int = 7) -> Iterator[Array]:
    """Two squares that move before a ground that moves otherwise, and meet, (160, 320, 3) uint8.

    One has a shadow under it.
    """
    random = np.random.default_rng(0)
    ground, first, second = (
        cv2.GaussianBlur(random.integers(0, 256, shape, dtype=np.uint8), (0, 0), 1.5)
        for shape in ((160, 340, 3), (70, 70, 3), (70, 70, 3))
    )
    first[58:] = 9
    for t in range(frames):
        frame = ground[:, 2 * t : 2 * t + 320].copy()
        frame[20:90, 20 + 5 * t : 90 + 5 * t] = first
        frame[70:140, 150 - 4 * t : 220 - 4 * t] = second
        yield _read_only(frame)


def _cut_images() -> None:
    """Cut an image whole and one by blocks: a label that saves two others, and one that two share out."""
    from mlbs_actors.graphcut.energy import LabelCostEnergy
    from mlbs_actors.graphcut.graph_cut import searched_labels

    side = 2
    for cells in (16, 32):
        eighth = cells // 8
        saving, shared = np.full((2, 4, cells, cells), 100, np.int32)
        saving[1, :, : 4 * eighth] = saving[2, :, 4 * eighth :] = 0
        saving[3] = 1
        shared[1, :, 3 * eighth : 5 * eighth] = shared[2, :, : 3 * eighth] = shared[3, :, 5 * eighth :] = 0
        shared[2, :, 3 * eighth : 4 * eighth] = shared[3, :, 4 * eighth : 5 * eighth] = 1
        weights = np.full((side * cells, side * cells, 4), 5, np.int32)
        weights[:, -1, 0] = weights[-1, :, 1:] = weights[:, -1, 2] = weights[:, 0, 3] = 0
        label_costs = np.array([0, 2000, 2000, 2000]) * (cells // 16) ** 2
        for costs in (saving, shared):
            searched_labels(LabelCostEnergy(costs, weights, label_costs, side))


def _find_contact_shadow() -> None:
    """Look at a square with a dark strip under it."""
    from mlbs_actors.segmentation.contact_shadow import contact_shadow
    from mlbs_actors.segmentation.shadows import Darkening

    side, cells = 2, 40
    image = np.full((side * cells, side * cells, 3), 125, np.uint8)
    labels = np.zeros(image.shape[:2], np.uint16)
    labels[20:60, 20:60] = 1
    image[50:60, 20:60] = 9
    light = np.zeros((cells, cells), np.float32)
    light[25:30, 10:30] = -3
    even = np.zeros_like(light)
    contact_shadow(labels, image, Darkening(light, even, even + 10, even), side, 1.0, 0.25)


def _publish_again() -> None:
    """Publish labels that were found in the general way, and tally them anew as without a shadow."""
    from mlbs_actors.segmentation.group_labelling import Claims, Tally, publish_claims, tally

    side, cells = 2, 8
    cost, boxes, tracks = (
        np.zeros((2, cells, cells), np.uint8),
        np.zeros((2, 4), np.int64),
        np.zeros((2, 2), np.int64),
    )
    claims = Claims(cost, cost[0].copy(), boxes, tracks, np.arange(2, dtype=np.uint16), (0, 0), side)
    own, box, tallied = np.arange(2), (0, 0, cells, cells), Tally.of_nothing(2)
    labelling = np.zeros((side * cells, side * cells), np.int16)
    labelling[4:9, 4:9] = 1
    published, light = np.zeros(labelling.shape, np.uint16), np.zeros((cells, cells), np.float32)
    dark = (light, light, light + 10, light)
    publish_claims(labelling, claims, own, box, (0.0, 0.0), dark, published, tallied)
    tally(published, claims, own, box, tallied)


def _read_only(array: Array) -> Array:
    array.setflags(write=False)
    return array


def _focus_on_crowd() -> None:
    """Part blocks in two corners, one box around which would be most of the frame."""
    from mlbs_actors.flow.focus import BLOCK, focus_boxes

    blocks = np.zeros((12, 16), bool)
    blocks[:6, :6] = blocks[6:, 6:] = True
    focus_boxes(blocks, (12 * BLOCK, 16 * BLOCK))
