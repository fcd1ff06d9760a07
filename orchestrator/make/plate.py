"""The background plate as a video: what each pixel of a clip showed when nothing covered it.

Read in this order: here, how a plate is put together; ``camera_path`` and ``background_motion`` (where the
background of one frame lies in the others), ``holes``, ``source_frames`` (which frames a hole's background is
taken from), ``background_samples`` (what they show of it). Where a camera moves through a scene with depth,
``rigid_background`` knows better, by ``point_tracks``, ``scene_geometry`` with ``bundle_adjustment``,
``scenes_of_clip`` and ``depth_sweep`` with ``planes``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.determinism import single_threaded
from mlbs_actors.errors import FrameError
from mlbs_actors.messages import Array
from orchestrator.make.background_motion import (
    CELL,
    BackgroundMotion,
    in_picture,
    nodes_of,
    sketch_of,
    to_pixels,
)
from orchestrator.make.background_samples import Sample, agreed, at_points, corrected, sampled
from orchestrator.make.holes import Hole, holes_of
from orchestrator.make.rigid_background import samples_in_scene
from orchestrator.make.scenes_of_clip import ScenesOfClip
from orchestrator.make.source_frames import (
    EDGE,
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
#: Of the picture's width: how much around a hole is compared with the sources.
CONTEXT = 1 / 10
#: A camera that has moved by less stands still, px of a sketch.
STILL_PX = 0.25
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
    scenes = ScenesOfClip(motion)
    for index, (frame, covered) in enumerate(_checked(frames())):
        with single_threaded():
            source = _source(index, frame, covered)
            motion.add(frame, source.sketch)
            scenes.add(source.sketch)
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
            plate = _filled(index, *pair, _Clip(motion, scenes, list(sources.values())), plate)
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
    return source_of(index, frame, covered, sketch_of(frame, _widened(covered, EDGE)))


def _widened(covered: Array, share: float) -> Array:
    """Widen what is covered by a share of the picture's width, (H, W) uint8."""
    margin = max(1, round(share * covered.shape[1]))
    hidden: Array = cv2.dilate(covered.astype(np.uint8), np.ones((2 * margin + 1,) * 2, np.uint8))
    return hidden


@dataclass(frozen=True, slots=True)
class _Clip:
    """What is known of a clip around one of its frames."""

    motion: BackgroundMotion
    scenes: ScenesOfClip
    sources: Sequence[Source]


def _filled(
    index: int, frame: Array, covered: Array, clip: _Clip, before: BackgroundFrame | None
) -> BackgroundFrame:
    """Fill a frame; ``before`` is the one before it, filled."""
    never: Array = np.zeros(covered.shape, np.bool_)
    if not covered.any():
        return BackgroundFrame(frame.copy(), never)
    hidden = _widened(covered, MARGIN)
    picture, gap = frame.copy(), np.zeros(covered.shape, np.uint8)
    doubtful = gap.copy()
    for hole in holes_of(frame, hidden, CONTEXT):
        found = agreed(_samples(index, hole, clip), len(hole.inside))
        colours, made = found.colours, found.seen.copy()
        if before is not None and not made.all():
            colours[~found.seen], made[~found.seen] = _carried(index, hole, clip.motion, before, ~found.seen)
        picture.reshape(-1, 3)[hole.inside] = np.round(colours)
        never.flat[hole.inside] = ~found.seen
        gap.flat[hole.inside] = ~made
        doubtful.flat[hole.inside] = ~found.clear
    if gap.all():
        picture[:] = np.round(frame.mean(axis=(0, 1)))
    elif gap.any():
        # An object's edge would spread over the gap behind it.
        painted = cv2.inpaint(picture, gap | doubtful, INPAINT_PX, cv2.INPAINT_TELEA)
        picture[gap > 0] = painted[gap > 0]
    inside = hidden > 0
    away = cv2.distanceTransform(1 - covered.astype(np.uint8), cv2.DIST_L2, 3)[inside]
    share = np.clip(1.0 - away / (MARGIN * frame.shape[1] + 1), 0.0, 1.0)[:, None]
    picture[inside] = np.round(picture[inside] * share + frame[inside] * (1 - share))
    return BackgroundFrame(picture, never)


def _samples(index: int, hole: Hole, clip: _Clip) -> list[Sample]:
    """Sample the sources that show a hole, by depth; by the background's motion where that is unknown."""
    scene = clip.scenes.scene(index)
    samples = [] if scene is None else samples_in_scene(index, hole, scene, clip.sources)
    if scene is None or not samples:
        return _moved_samples(index, hole, clip.motion, clip.sources)
    left = [one for one in clip.sources if one.index not in scene.numbers]
    unseen = np.all([one.weight == 0 for one in samples], axis=0)
    if unseen.any():
        others = _moved_samples(index, hole, clip.motion, left)
        samples += [
            Sample(one.colours, np.where(unseen, one.weight, 0), one.clear & unseen) for one in others
        ]
    return samples


def _moved_samples(
    index: int, hole: Hole, motion: BackgroundMotion, sources: Sequence[Source]
) -> list[Sample]:
    """Sample the sources that show a hole, placed by the background's motion."""
    places = motion.places(index, nodes_of(hole.region), [index, *(one.index for one in sources)])
    size = (hole.region.width // CELL, hole.region.height // CELL)
    wanted = cv2.resize(hole.sketch.free, size, interpolation=cv2.INTER_AREA)
    wanted = cv2.erode(wanted, np.ones((3, 3), np.uint8)) == 0
    nearness = {other: motion.nearness(index, other) for other in places}
    chosen = chosen_sources(sources, {other: at[wanted] for other, at in places.items()}, nearness, index)
    samples = []
    for source in chosen:
        at = places[source.index]
        still = np.abs(at - places[index]).max() < STILL_PX
        there = hole.pixels() if still else corrected(hole, source, to_pixels(at))
        samples.append(sampled(hole, source, there, nearness[source.index]))
    return samples


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
