"""Compiles all kernels, or loads their machine code, before the first frame needs them.

Each process of a stream loads those of its own part. ``python -m mlbs_actors.warm_up`` and
:func:`compile_kernels` compile what every run needs, once after an installation, in two processes; existing
machine code is only loaded.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from time import perf_counter

import cv2
import numpy as np

from mlbs_actors.config import Config, load_config
from mlbs_actors.errors import MlbsError
from mlbs_actors.kernels.machine_code import compiled_mark, machine_code_folder
from mlbs_actors.messages import (
    Array,
    FrameEvidence,
    LayerKind,
    LayerPosterior,
    LayerTracks,
    Segmentation,
    readonly,
)

__all__ = ["compile_kernels", "main", "warm_coordinator", "warm_layer", "warm_segmenter"]

#: Interval of calls and messages about the progress, s.
_PROGRESS_SECONDS = 5.0

#: The squares of the small scene: left and top edge in its first frame and motion to the right, px.
_SIDE = 70
_SQUARES = ((20, 20, 5), (150, 70, -4))
_GROUND_MOTION = -2
_SHAPE = (160, 320)

#: Its layers have cells of 2 px, as those of larger frames do.
_CELL = 2
_LAYERS = load_config(None, ["grid.cell_px=5"])


def main() -> int:
    """Compile, and report progress; or, with names of parts as arguments, compile those in this process."""
    if parts := sys.argv[1:]:
        for name in parts:
            _PARTS[name]()
            compiled_mark(_PARTS[name].__name__).touch()
        return 0

    def say(seconds: float, kernels: int) -> None:
        print(f"  compiling for {seconds:.0f} s, {kernels} kernels so far", file=sys.stderr, flush=True)

    compile_kernels(say)
    return 0


def compile_kernels(progress: Callable[[float, int], None] | None = None) -> None:
    """Compile what every run needs, in two processes, so that no first frame has to wait for it.

    It takes one to three minutes on two idle cores, once after an installation; what is compiled already is
    only loaded.

    Parameters
    ----------
    progress : callable, optional
        Called every five seconds with the seconds so far and the number of kernels that are compiled; there
        are about 300. What it raises ends the compilation; what was compiled is kept.

    Raises
    ------
    MlbsError
        If a process failed.
    ConfigError
        If there is no folder for the machine code.
    """
    started, folder = perf_counter(), machine_code_folder()
    # Not multiprocessing, which would run the caller's program again if that has no guard for it.
    command = [sys.executable, "-m", "mlbs_actors.warm_up"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    working = [
        subprocess.Popen([*command, *parts], env=environment, stderr=subprocess.PIPE, text=True)
        for parts in (("coordinator",), ("segmenter", "layer"))
    ]
    try:
        for one in working:
            while True:
                try:
                    _, said = one.communicate(timeout=_PROGRESS_SECONDS)
                    break
                except subprocess.TimeoutExpired:
                    if progress is not None:
                        progress(perf_counter() - started, sum(1 for _ in folder.rglob("*.nbc")))
            if one.returncode:
                reason = (said.strip().splitlines() or [f"exit status {one.returncode}"])[-1]
                raise MlbsError(f"The kernels cannot be compiled: {reason}.")
    finally:
        for one in working:
            one.terminate()  # does nothing to one that has ended
            one.communicate()


def warm_coordinator() -> None:
    """Track and cluster a small scene with two objects, then trigger what a scene needs only by chance.

    Otherwise the kernels for objects would be loaded at a stream's first birth: a quarter of a second.
    """
    from mlbs_actors.coordinator import Coordinator

    coordinator = Coordinator(Config())
    labelled: dict[int, Segmentation] = {}
    for t, frame in enumerate(_small_scene()):
        wanted = coordinator.feedback_index(t)
        feedback = None if wanted is None else partial(labelled.__getitem__, wanted)
        for evidence in coordinator.step(t, frame, feedback):
            labelled[evidence.frame_index] = _labelled_by_tracks(evidence)
    _focus_on_crowd()
    _change_light()


def warm_layer() -> None:
    """Run a layer of either kind over frames of the small scene."""
    for _, posteriors in _layers_at_work():
        assert posteriors


def warm_segmenter() -> None:
    """Label frames of the small scene with its layers, then trigger what a scene needs only by chance."""
    from mlbs_actors.segmentation.segmenter import Segmenter

    segmenter = Segmenter(_LAYERS)
    for (evidence, posteriors), frame in zip(_layers_at_work(), _small_scene(), strict=True):
        segmenter.step(evidence, frame, posteriors)
    _cut_images()
    _find_contact_shadow()


def _layers_at_work() -> Iterator[tuple[FrameEvidence, list[LayerPosterior]]]:
    """Yield the small scene's evidence as it is, and the posteriors of its layers."""
    from mlbs_actors.layer.layer import Layer

    layers: dict[int, Layer] = {}
    previous = None
    for t, frame in enumerate(_small_scene()):
        evidence = _true_evidence(t, frame)
        for one in evidence.tracks:
            layers.setdefault(one.layer, Layer(_LAYERS, one.layer, one.kind))
        yield evidence, [readonly(layer.step(evidence, previous)) for layer in layers.values()]
        previous = _labelled_by_tracks(evidence)


def _true_evidence(t: int, frame: Array) -> FrameEvidence:
    """Return what the coordinator would find in a frame of the small scene.

    The arrays are read-only, like those of real frames: for Numba that is another type, with kernels of its
    own.
    """
    cells = (_SHAPE[0] // _CELL, _SHAPE[1] // _CELL)
    moving = np.zeros((*cells, 2), np.float32)
    moving[..., 0] = _GROUND_MOTION
    owner = np.zeros(cells, int)
    for layer, (left, top, motion) in enumerate(_SQUARES, start=1):
        box = np.array([top, top + _SIDE, left + motion * t, left + motion * t + _SIDE]) // _CELL
        inside = np.s_[box[0] : box[1], box[2] : box[3]]
        moving[inside], owner[inside] = (motion, 0), layer
    rows, columns = (part.ravel() for part in np.mgrid[2 : cells[0] : 4, 2 : cells[1] : 4])
    order = np.argsort(owner[rows, columns], kind="stable")
    rows, columns = rows[order], columns[order]
    ends = np.cumsum(np.bincount(owner[rows, columns], minlength=1 + len(_SQUARES))).tolist()
    kinds: tuple[LayerKind, ...] = ("background", "object", "object")
    camera = np.eye(3)
    camera[0, 2] = -_GROUND_MOTION
    return readonly(
        FrameEvidence(
            frame_index=t,
            shape=_SHAPE,
            camera=camera,
            flow=-moving,
            flow_reliable=np.ones(cells, bool),
            unexplained=np.where(owner > 0, 255, 0).astype(np.uint8),
            colours=cv2.resize(frame, cells[::-1], interpolation=cv2.INTER_AREA),
            tracks=tuple(
                LayerTracks(layer, kind, t - 1, start, end)
                for layer, (kind, start, end) in enumerate(zip(kinds, [0, *ends], ends, strict=False))
            ),
            positions=np.stack([columns, rows], axis=1).astype(np.float32) * _CELL,
            motions=moving[rows, columns],
            retired=(),
            latency_frames=0,
        )
    )


def _labelled_by_tracks(evidence: FrameEvidence) -> Segmentation:
    """Return a frame's label map in which the box of an object's trajectories is the object."""
    labels = np.zeros(evidence.shape, np.uint16)
    for one in evidence.tracks:
        if one.kind == "object" and one.end > one.start:
            x, y, width, height = cv2.boundingRect(evidence.positions[one.start : one.end])
            labels[max(y, 0) : y + height, max(x, 0) : x + width] = one.layer
    return readonly(
        Segmentation(
            frame_index=evidence.frame_index,
            labels=labels,
            normaliser=np.zeros(evidence.flow_reliable.shape, np.uint8),
            fallback=np.zeros(evidence.flow_reliable.shape, np.int8),
            layers=(),
            camera_motion=(0.0, 0.0),
            latency_frames=0,
        )
    )


def _small_scene(frames: int = 7) -> Iterator[Array]:
    """Yield two squares that meet, moving against moving ground, (160, 320, 3) uint8.

    One has a shadow under it.
    """
    random = np.random.default_rng(0)
    height, width = _SHAPE
    ground, *squares = (
        cv2.GaussianBlur(random.integers(0, 256, shape, dtype=np.uint8), (0, 0), 1.5)
        for shape in ((height, width + 20, 3), (_SIDE, _SIDE, 3), (_SIDE, _SIDE, 3))
    )
    squares[0][58:] = 9
    for t in range(frames):
        shift = -_GROUND_MOTION * t
        frame = ground[:, shift : shift + width].copy()
        for square, (left, top, motion) in zip(squares, _SQUARES, strict=True):
            frame[top : top + _SIDE, left + motion * t : left + motion * t + _SIDE] = square
        frame.setflags(write=False)
        yield frame


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


#: Parts of a stream, each with kernels of its own.
_PARTS: dict[str, Callable[[], None]] = {
    "coordinator": warm_coordinator,
    "segmenter": warm_segmenter,
    "layer": warm_layer,
}

if __name__ == "__main__":
    sys.exit(main())
