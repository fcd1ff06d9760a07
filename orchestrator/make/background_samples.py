"""What another frame shows of a frame's background: laid over it, in its light, weighted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array
from orchestrator.make.background_motion import continued, drift, in_picture, looked_up, moved
from orchestrator.make.holes import Hole
from orchestrator.make.source_frames import BESIDE, Source

__all__ = ["Background", "Sample", "agreed", "at_points", "corrected", "sampled"]

#: Grey levels by which a source that is placed well misses the frame.
NOISE = 6.0
#: A source that misses the frame by more around a pixel shows nothing of it, grey levels.
MISFIT = 40.0
#: Weight of a pixel near what covers its source, against that of one far from it, and of one right beside it,
#: which counts where nothing else is known.
SUSPECT, BARELY = 0.02, 0.001
#: Samples that differ by more from their median show something else, grey levels.
AGREED = 14.0
#: Least and greatest change of light between two frames that is corrected.
GAIN = (0.6, 1.7)


@dataclass(frozen=True, slots=True)
class Sample:
    """What a source shows of a hole.

    Attributes
    ----------
    colours : (n, 3) float32
        BGR, in the frame's light.
    weight : (n,) float32
        0 where it shows nothing.
    clear : (n,) bool
        Where what it shows is not right beside what covers it.
    """

    colours: Array
    weight: Array
    clear: Array


@dataclass(frozen=True, slots=True)
class Background:
    """What samples say of a hole together.

    Attributes
    ----------
    colours : (n, 3) float32
        BGR.
    seen, clear : (n,) bool
        Where any sample shows it, and where one does clearly.
    """

    colours: Array
    seen: Array
    clear: Array


def corrected(hole: Hole, source: Source, there: Array) -> Array:
    """Correct where a source lies: it is measured where both show the background, and continued smoothly.

    Parameters
    ----------
    hole : Hole
    source : Source
    there : (h, w, 2) float32
        Where the pixels of the hole's region lie in the source's sketch.

    Returns
    -------
    (h, w, 2) float32
    """
    gray = looked_up(source.sketch.gray, there)
    free = looked_up(source.sketch.free, there, cv2.INTER_NEAREST)
    return moved(there, drift(hole.sketch.gray, gray, (hole.sketch.free & free) > 0))


def sampled(hole: Hole, source: Source, there: Array, nearness: float) -> Sample:
    """Sample a source.

    Parameters
    ----------
    hole : Hole
    source : Source
    there : (h, w, 2) float32
        Where the pixels of the hole's region lie in the source's sketch.
    nearness : float
        How much it counts.

    Returns
    -------
    Sample
    """
    frame = hole.sketch
    both = (frame.free & looked_up(source.sketch.free, there, cv2.INTER_NEAREST)) > 0
    colours = looked_up(source.sketch.colours, there).astype(np.float32)
    gain = _gain(frame.colours[both], colours[both])
    misfit = np.abs(colours * gain - frame.colours).mean(axis=2)
    error = continued(misfit[..., None], both.astype(np.float32), floor=0.05)

    at = at_points(np.dstack([there, error]), hole.at)
    pixels = in_picture(at[:, :2], source.sketch.gray.shape, source.picture.shape)
    clear = at_points(source.clear, pixels, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT).astype(
        np.float32
    ) / np.float32(255)
    seen = at_points(source.picture, pixels, cv2.INTER_CUBIC).astype(np.float32) * gain
    trust = np.where(at[:, 2] < MISFIT, 1.0 / (1.0 + (at[:, 2] / NOISE) ** 2) ** 2, 0)
    weight = np.where(clear > BESIDE, SUSPECT + clear, BARELY) * trust * nearness
    weight = np.where(clear > 0, weight, 0).astype(np.float32)
    return Sample(seen, weight, (clear > BESIDE) & (weight > 0))


def at_points(
    picture: Array, points: Array, how: int = cv2.INTER_LINEAR, border: int = cv2.BORDER_REPLICATE
) -> Array:
    """Return a picture's values at points (n, 2) float32, (n, …)."""
    row = 1024  # a map of OpenCV has a limited height and width
    padded = np.zeros((-(-len(points) // row) * row, 2), np.float32)
    padded[: len(points)] = points
    values = looked_up(picture, padded.reshape(-1, row, 2), how, border)
    return values.reshape(len(padded), *picture.shape[2:])[: len(points)]


def _gain(target: Array, seen: Array) -> Array:
    """Return the factor (3,) float32 that brings colours (n, 3) of a source into the frame's light."""
    usable = ((target > 12) & (target < 244) & (seen > 12) & (seen < 244)).all(axis=1)
    if usable.sum() < 50:
        return np.ones(3, np.float32)
    ratio = np.median(target[usable].astype(np.float32) / seen[usable], axis=0)
    return np.clip(ratio, *GAIN).astype(np.float32)


def agreed(samples: Sequence[Sample], number: int) -> Background:
    """Combine samples of so many pixels: the mean of those near their median, where there are any.

    Parameters
    ----------
    samples : sequence of Sample
    number : int

    Returns
    -------
    Background
    """
    if not samples:
        nothing = np.zeros(number, np.bool_)
        return Background(np.zeros((number, 3), np.float32), nothing, nothing)
    colours = np.stack([one.colours for one in samples])
    weights = np.stack([one.weight for one in samples])
    total = weights.sum(axis=0)
    order = np.argsort(colours, axis=0, kind="stable")
    heavy = np.take_along_axis(np.broadcast_to(weights[..., None], colours.shape), order, axis=0)
    half = (np.cumsum(heavy, axis=0) >= 0.5 * total[:, None]).argmax(axis=0)
    middle = np.take_along_axis(np.take_along_axis(colours, order, axis=0), half[None], axis=0)[0]
    share = weights**2 * (np.abs(colours - middle).max(axis=2) < AGREED)
    whole = share.sum(axis=0)
    mean = (colours * share[..., None]).sum(axis=0) / np.maximum(whole, 1e-20)[:, None]
    agreed = np.where((whole > 1e-20)[:, None], mean, middle)
    clear = np.any([one.clear for one in samples], axis=0)
    return Background(np.clip(agreed, 0, 255).astype(np.float32), total > 0, clear)
