"""Compiles all kernels, or loads their machine code, before the first frame needs them.

``python -m mlbs_actors.warm_up`` compiles what every run needs, once after an installation, in two processes;
existing machine code is only loaded.
"""

from __future__ import annotations

import logging
import multiprocessing
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import FIRST_EXCEPTION, ProcessPoolExecutor, wait
from contextlib import contextmanager
from time import perf_counter

import cv2
import numpy as np

from mlbs_actors.config import Config
from mlbs_actors.messages import Array, FrameEvidence, LayerKind, LayerTracks, Segmentation, readonly

__all__ = ["main", "warm_layer", "warm_stream"]

#: Interval of progress messages, s.
_PROGRESS_SECONDS = 5.0


def main() -> int:
    """Warm up in two processes that share the work, and report progress."""
    started = perf_counter()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        pending = {pool.submit(_warm_layer_and_cut), pool.submit(_label_small_scene)}
        while pending:
            done, pending = wait(pending, _PROGRESS_SECONDS, return_when=FIRST_EXCEPTION)
            for one in done:
                one.result()
            if pending:
                print(f"  compiling for {perf_counter() - started:.0f} s", file=sys.stderr, flush=True)
    return 0


def warm_layer() -> None:
    """Run a layer of either kind over two small frames.

    The arrays are read-only, like those of real frames: for Numba that is another type, with kernels of its
    own.
    """
    from mlbs_actors.layer.layer import Layer

    config = Config()
    height, width = 480, 640
    cells = (height // 2, width // 2)
    random = np.random.default_rng(0)
    columns, rows = np.meshgrid(np.arange(140, 180, 8), np.arange(100, 140, 8))
    count = columns.size  # of each layer's trajectories, which are at the same places
    positions = np.tile(np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float32), (2, 1))
    motions = random.normal(size=positions.shape).astype(np.float32)  # so that there is a field to solve
    kinds: tuple[LayerKind, ...] = ("background", "object")
    for layer, kind in enumerate(kinds):
        part = Layer(config, layer, kind)
        previous = None
        for t in range(2):
            evidence = FrameEvidence(
                frame_index=t,
                shape=(height, width),
                camera=np.eye(3),
                flow=np.zeros((*cells, 2), np.float32),
                flow_reliable=np.ones(cells, bool),
                unexplained=np.full(cells, 255, np.uint8),
                colours=random.integers(0, 256, (*cells, 3), dtype=np.uint8),
                tracks=tuple(
                    LayerTracks(one, kinds[one], t - 1, one * count, (one + 1) * count) for one in range(2)
                ),
                positions=positions,
                motions=motions,
                retired=(),
                latency_frames=0,
            )
            part.step(readonly(evidence), previous)
            segmentation = Segmentation(
                frame_index=t,
                labels=np.full((height, width), layer, np.uint16),
                normaliser=np.zeros(cells, np.uint8),
                fallback=np.zeros(cells, np.int8),
                layers=(),
                camera_motion=(0.0, 0.0),
                latency_frames=0,
            )
            previous = readonly(segmentation)


def warm_stream() -> None:
    """Label a small scene with objects, then trigger the kernels that a scene uses only by chance.

    Otherwise the kernels for objects would be loaded at a stream's first birth: a quarter of a second.
    """
    _label_small_scene()
    _cut_images()
    _find_contact_shadow()


def _warm_layer_and_cut() -> None:
    warm_layer()
    _cut_images()
    _find_contact_shadow()


def _label_small_scene() -> None:
    from mlbs_actors.subtractor import MultilayerSubtractor

    subtractor = MultilayerSubtractor()
    with _held_back(logging.getLogger(MultilayerSubtractor.__module__)):  # it would advise to do this
        for frame in _small_scene():
            subtractor.apply(frame)
    _focus_on_crowd()
    _change_light()


@contextmanager
def _held_back(log: logging.Logger) -> Iterator[None]:
    """Drop what this thread logs there; what others log, and what is logged later, is nothing to us."""
    ours = threading.get_ident()

    def from_elsewhere(record: logging.LogRecord) -> bool:
        return record.thread != ours

    log.addFilter(from_elsewhere)
    try:
        yield
    finally:
        log.removeFilter(from_elsewhere)


def _small_scene(frames: int = 7) -> Iterator[Array]:
    """Yield two squares that meet, moving against moving ground, (160, 320, 3) uint8.

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
    """Cut an image whole and by blocks: one label frees two others, and one is shared out to two."""
    from mlbs_actors.graphcut.energy import LabelCostEnergy
    from mlbs_actors.graphcut.graph_cut import minimise

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
        places = np.tile(np.array([0, cells, 0, cells]), (4, 1))
        for costs in (saving, shared):
            energy = LabelCostEnergy(costs, weights, label_costs, places, side)
            minimise(energy, Config().segmentation.most_cut_whole)


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
    dark = Darkening(light, even, even + 10, even)
    contact_shadow(labels, image, dark, side, 1.0, Config().segmentation)


def _focus_on_crowd() -> None:
    """Split blocks in two corners, whose common box would be most of the frame."""
    from mlbs_actors.flow.focus import BLOCK, focus_boxes

    blocks = np.zeros((12, 16), bool)
    blocks[:6, :6] = blocks[6:, 6:] = True
    focus_boxes(blocks, (12 * BLOCK, 16 * BLOCK), Config().flow)


def _change_light() -> None:
    """Compare colours before and after the light has become another one."""
    from mlbs_actors.footage.light import light_change

    before = np.arange(600, dtype=np.uint8).reshape(-1, 3)
    light_change(before, before // 2 + 40)


def _read_only(array: Array) -> Array:
    array.setflags(write=False)
    return array


if __name__ == "__main__":
    sys.exit(main())
