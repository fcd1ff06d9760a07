"""The background plate as a video: what each pixel of a clip showed when nothing covered it.

Read in this order: here, how a plate is put together; ``camera_path`` and ``background_motion`` (where the
background of one frame lies in the others), ``source_frames`` (which of them a frame's is taken from),
``background_samples`` (what they show of it).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.determinism import single_threaded
from mlbs_actors.errors import FrameError
from mlbs_actors.messages import Array, Region
from orchestrator.make.background_motion import (
    CELL,
    BackgroundMotion,
    Sketch,
    nodes_of,
    sketch_of,
    to_pixels,
)
from orchestrator.make.background_samples import Hole, at_points, in_picture, sampled
from orchestrator.make.source_frames import (
    NEAR_STEP,
    Source,
    SpreadSources,
    chosen_sources,
    held_sources,
    near_sources,
    source_of,
)

__all__ = ["BackgroundFrame", "CoveredFrame", "fill_background"]

#: A frame (H, W, 3) uint8 BGR, and where it does not show the background, (H, W) bool.
CoveredFrame = tuple[Array, Array]

#: Of the picture's width: what is replaced beyond what is covered, and fades into the frame.
MARGIN = 1 / 160
#: Of the picture's width: beside what covers it, a source is not believed.
EDGE = 1 / 320
#: Of the picture's width: how much around a hole is compared with the sources.
CONTEXT = 1 / 10
#: Samples that differ by more from their median show something else, grey levels.
AGREED = 14.0
#: How far around a pixel that was never seen colours are taken from, px.
INPAINT_PX = 5


@dataclass(frozen=True, slots=True)
class BackgroundFrame:
    """A frame without what covers its background.

    Attributes
    ----------
    picture : (H, W, 3) uint8
        BGR.
    never_seen : (H, W) bool
        Pixels that no frame of the clip shows uncovered; their colours are made up.
    """

    picture: Array
    never_seen: Array


def fill_background(frames: Callable[[], Iterable[CoveredFrame]]) -> Iterator[BackgroundFrame]:
    """Show each frame of a clip without what covers its background.

    What is covered, and a soft edge around it, is taken from other frames of the clip, wherever in it these
    show the place: laid over the frame by the background's motion, in its light, by a median that outvotes
    what a mask has missed. What no frame shows is made up, continued from frame to frame, and marked. Nothing
    else changes. The same input gives the same bytes.

    Frames held at once, at full size: at most 200, in at most :data:`~orchestrator.make.source_frames.
    HELD_BYTES` of memory, but at least 12.

    Parameters
    ----------
    frames : callable
        Returns an iterable over the clip, each frame with a (H, W) bool mask of what covers its background.
        It is called three times, and the last two are read at the same time. All frames have one size.

    Yields
    ------
    BackgroundFrame
        One for each frame, in order.

    Raises
    ------
    FrameError
        If a frame is no (H, W, 3) uint8 picture, its mask or a later frame is of another size, or the clip is
        not the same each time it is read.
    """
    motion, spread, near = BackgroundMotion(), SpreadSources(1), 0
    for index, (frame, covered) in enumerate(_checked(frames())):
        with single_threaded():
            source = _source(index, frame, covered)
            motion.add(frame, source.sketch)
        if index == 0:
            near = held_sources(covered.shape) // 2
            spread = SpreadSources(near)
        if spread.wants(index):
            spread.add(source)
    number = len(motion.poses)
    clip, around = iter(_checked(frames())), near_sources(_sources(frames()), number, near)
    plate: BackgroundFrame | None = None
    for index in range(number):
        pair = next(clip, None)
        if pair is None:
            raise FrameError(f"The clip had {number} frames, and {index} when it was read again.")
        with single_threaded():
            sources = {one.index: one for one in (*spread.kept, *next(around))}
            plate = _filled(index, *pair, motion, list(sources.values()), plate)
        yield plate


def _checked(frames: Iterable[CoveredFrame]) -> Iterator[CoveredFrame]:
    first: tuple[int, ...] | None = None
    for index, (frame, covered) in enumerate(frames):
        if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8:
            raise FrameError(f"Frame {index} is {frame.shape} {frame.dtype}; give (H, W, 3) uint8, BGR.")
        if covered.shape != frame.shape[:2] or covered.dtype != np.bool_:
            raise FrameError(
                f"The mask of frame {index} is {covered.shape} {covered.dtype}; give {frame.shape[:2]} bool."
            )
        first = first or frame.shape
        if frame.shape != first:
            raise FrameError(f"Frame {index} is {frame.shape}, the first {first}; give frames of one size.")
        yield frame, covered


def _sources(frames: Iterable[CoveredFrame]) -> Iterator[Source]:
    for index, (frame, covered) in enumerate(_checked(frames)):
        if index % NEAR_STEP == 0:
            yield _source(index, frame, covered)


def _source(index: int, frame: Array, covered: Array) -> Source:
    hidden = _widened(covered, EDGE)
    return source_of(index, frame, hidden, sketch_of(frame, hidden))


def _widened(covered: Array, share: float) -> Array:
    """Widen what is covered by a share of the picture's width, (H, W) uint8."""
    margin = max(1, round(share * covered.shape[1]))
    hidden: Array = cv2.dilate(covered.astype(np.uint8), np.ones((2 * margin + 1,) * 2, np.uint8))
    return hidden


def _filled(
    index: int,
    frame: Array,
    covered: Array,
    motion: BackgroundMotion,
    sources: Sequence[Source],
    before: BackgroundFrame | None,
) -> BackgroundFrame:
    """Fill a frame; ``before`` is the one before it, filled."""
    never: Array = np.zeros(covered.shape, np.bool_)
    if not covered.any():
        return BackgroundFrame(frame.copy(), never)
    hidden = _widened(covered, MARGIN)
    hole, inside = _hole(frame, hidden), hidden > 0
    places = motion.places(index, nodes_of(hole.region), [index, *(one.index for one in sources)])
    colours, seen = _seen(index, hole, motion, sources, places)
    never[inside] = ~seen
    picture = frame.copy()
    made = seen.copy()
    if before is not None and not seen.all():
        colours[~seen], made[~seen] = _carried(index, hole, motion, before, ~seen)
    picture[inside] = np.round(colours)
    gap = np.zeros(covered.shape, np.uint8)
    gap[inside] = ~made
    if gap.all():
        picture[:] = np.round(frame.mean(axis=(0, 1)))
    elif gap.any():
        picture = cv2.inpaint(picture, gap, INPAINT_PX, cv2.INPAINT_TELEA)
    away = cv2.distanceTransform(1 - covered.astype(np.uint8), cv2.DIST_L2, 3)[inside]
    share = np.clip(1.0 - away / (MARGIN * frame.shape[1] + 1), 0.0, 1.0)[:, None]
    picture[inside] = np.round(picture[inside] * share + frame[inside] * (1 - share))
    return BackgroundFrame(picture, never)


def _hole(frame: Array, hidden: Array) -> Hole:
    """Cut a hole and what is around it out of a frame."""
    sketch = sketch_of(frame, hidden)
    height, width = sketch.gray.shape
    x, y, across, down = cv2.boundingRect(1 - sketch.free)
    context = round(CONTEXT * width)
    left, top = (max(0, start - context) // CELL * CELL for start in (x, y))
    right, bottom = min(width, x + across + context), min(height, y + down + context)
    region = Region(left, top, -(-(right - left) // CELL) * CELL, -(-(bottom - top) // CELL) * CELL)
    beyond = (0, max(0, region.y + region.height - height), 0, max(0, region.x + region.width - width))
    colours, gray = (
        np.ascontiguousarray(cv2.copyMakeBorder(one, *beyond, cv2.BORDER_REPLICATE)[region.slices])
        for one in (sketch.colours, sketch.gray)
    )
    free = cv2.copyMakeBorder(sketch.free, *beyond, cv2.BORDER_CONSTANT, value=0)[region.slices]
    rows, columns = np.nonzero(hidden)
    at = in_picture(np.stack([columns, rows], axis=1), hidden.shape, sketch.gray.shape)
    at -= np.array([region.x, region.y], np.float32)
    return Hole(region, Sketch(colours, gray, np.ascontiguousarray(free)), at)


def _seen(
    index: int, hole: Hole, motion: BackgroundMotion, sources: Sequence[Source], places: Mapping[int, Array]
) -> tuple[Array, Array]:
    """Return the colours (n, 3) float32 that other frames show of a hole, and where they do, (n,) bool."""
    size = (hole.region.width // CELL, hole.region.height // CELL)
    wanted = cv2.resize(hole.sketch.free, size, interpolation=cv2.INTER_AREA)
    wanted = cv2.erode(wanted, np.ones((3, 3), np.uint8)) == 0
    nearness = {other: motion.nearness(index, other) for other in places}
    chosen = chosen_sources(sources, {other: at[wanted] for other, at in places.items()}, nearness, index)
    if not chosen:
        return np.zeros((len(hole.at), 3), np.float32), np.zeros(len(hole.at), np.bool_)
    samples = [sampled(hole, source, places[source.index]) for source in chosen]
    weights = [
        np.float32(nearness[source.index]) * one.weight for source, one in zip(chosen, samples, strict=True)
    ]
    return _agreed(np.stack([one.colours for one in samples]), np.stack(weights))


def _carried(
    index: int, hole: Hole, motion: BackgroundMotion, before: BackgroundFrame, wanted: Array
) -> tuple[Array, Array]:
    """Return the colours (m, 3) of the frame before at wanted pixels of a hole, and where it has any."""
    places = motion.places(index, nodes_of(hole.region), [index - 1])
    if not places:
        return np.zeros((int(wanted.sum()), 3), np.float32), np.zeros(int(wanted.sum()), np.bool_)
    there = at_points(to_pixels(places[index - 1]), hole.at[wanted])
    at = in_picture(there, motion.size, before.never_seen.shape)
    height, width = before.never_seen.shape
    within: Array = np.all((at >= 0) & (at <= (width - 1, height - 1)), axis=1)
    return at_points(before.picture, at).astype(np.float32), within


def _agreed(colours: Array, weights: Array) -> tuple[Array, Array]:
    """Combine samples: the mean of those near their median, where there are any.

    Parameters
    ----------
    colours : (k, n, 3) float32
    weights : (k, n) float32

    Returns
    -------
    (n, 3) float32
    (n,) bool
    """
    total = weights.sum(axis=0)
    order = np.argsort(colours, axis=0, kind="stable")
    heavy = np.take_along_axis(np.broadcast_to(weights[..., None], colours.shape), order, axis=0)
    half = (np.cumsum(heavy, axis=0) >= 0.5 * total[:, None]).argmax(axis=0)
    middle = np.take_along_axis(np.take_along_axis(colours, order, axis=0), half[None], axis=0)[0]
    share = weights**2 * (np.abs(colours - middle).max(axis=2) < AGREED)
    whole = share.sum(axis=0)
    mean = (colours * share[..., None]).sum(axis=0) / np.maximum(whole, 1e-20)[:, None]
    agreed = np.where((whole > 1e-20)[:, None], mean, middle)
    return np.clip(agreed, 0, 255).astype(np.float32), total > 0
