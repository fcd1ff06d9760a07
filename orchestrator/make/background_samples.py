"""What another frame shows of a frame's background: laid over it, in its light, with a weight for each pixel.

A source is placed by the background's motion. What it misses by is measured where both show the background,
and continued smoothly into the hole.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array, Region
from orchestrator.make.background_motion import Sketch, continued, drift, looked_up, moved, to_pixels
from orchestrator.make.source_frames import Source

__all__ = ["Hole", "Sample", "at_points", "in_picture", "sampled"]

#: Grey levels by which a source that is placed well misses the frame.
NOISE = 6.0
#: A source that misses the frame by more around a pixel shows nothing of it, grey levels.
MISFIT = 40.0
#: Weight of a pixel beside what covers its source, against that of one far from it.
SUSPECT = 0.02
#: Least and greatest change of light between two frames that is corrected.
GAIN = (0.6, 1.7)


@dataclass(frozen=True, slots=True)
class Hole:
    """The pixels of a frame whose background is wanted.

    Attributes
    ----------
    region : Region
        Of the sketch, in whole cells: the hole and what is around it. It may reach beyond the picture.
    sketch : Sketch
        Of the region.
    at : (n, 2) float32
        The hole's pixels, (x, y) in the region of the sketch.
    """

    region: Region
    sketch: Sketch
    at: Array


@dataclass(frozen=True, slots=True)
class Sample:
    """What a source shows of a hole.

    Attributes
    ----------
    colours : (n, 3) float32
        BGR, in the frame's light.
    weight : (n,) float32
        0 where it shows nothing.
    """

    colours: Array
    weight: Array


def sampled(hole: Hole, source: Source, places: Array) -> Sample:
    """Sample a source.

    Parameters
    ----------
    hole : Hole
    source : Source
    places : (rows, columns, 2) float32
        Where the nodes of the hole's region lie in the source's sketch, px.

    Returns
    -------
    Sample
    """
    frame, there = hole.sketch, to_pixels(places)
    gray = looked_up(source.sketch.gray, there)
    free = looked_up(source.sketch.free, there, cv2.INTER_NEAREST)
    there = moved(there, drift(frame.gray, gray, (frame.free & free) > 0))

    both = (frame.free & looked_up(source.sketch.free, there, cv2.INTER_NEAREST)) > 0
    colours = looked_up(source.sketch.colours, there).astype(np.float32)
    gain = _gain(frame.colours[both], colours[both])
    misfit = np.abs(colours * gain - frame.colours).mean(axis=2)
    error = continued(misfit[..., None], both.astype(np.float32), floor=0.05)

    at = at_points(np.dstack([there, error]), hole.at)
    pixels = in_picture(at[:, :2], source.sketch.gray.shape, source.picture.shape)
    clear = at_points(source.clear, pixels, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT).astype(np.float32) / 255
    seen = at_points(source.picture, pixels, cv2.INTER_CUBIC).astype(np.float32) * gain
    trust = np.where(at[:, 2] < MISFIT, 1.0 / (1.0 + (at[:, 2] / NOISE) ** 2) ** 2, 0)
    weight = np.where(clear > 0, (SUSPECT + clear) * trust, 0)
    return Sample(seen, weight.astype(np.float32))


def in_picture(points: Array, size: tuple[int, ...], other: tuple[int, ...]) -> Array:
    """Return where points (n, 2) of a picture (height, width, …) lie in the same at another size."""
    scale = np.array([other[1] / size[1], other[0] / size[0]])
    there: Array = ((points + 0.5) * scale - 0.5).astype(np.float32)
    return there


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
