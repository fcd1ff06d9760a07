"""How a clip's background moves: from each frame to the next, also behind what covers it, and over many.

All of it is measured in *sketches*: the frames, at no more than :data:`SKETCH_WIDTH`, in which dense flow is
affordable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array, Region
from orchestrator.make.camera_path import CameraPath, Pose

__all__ = [
    "CELL",
    "BackgroundMotion",
    "Sketch",
    "continued",
    "drift",
    "in_picture",
    "looked_up",
    "moved",
    "nodes_of",
    "sketch_of",
    "to_pixels",
]

#: Width of a sketch, px, at most.
SKETCH_WIDTH = 640
#: The motion is kept for squares of this many pixels of a sketch, at their centres, the *nodes*.
CELL = 8
#: Flow this near to what covers the background is not believed, px of a sketch.
DISBELIEVED_PX = 4
#: A sketch with a side below has no dense flow, px.
LEAST_FLOW_PX = 32
#: A step in which nearly all of the background misses the homography by less is taken as one, px of a sketch.
FLAT_PX = 0.15
#: Frames over which steps are followed; farther ones are placed by the homography alone.
FOLLOWED = 60
#: Flow that is this far from that around it counts for a quarter, px of a sketch.
APART_PX = 1.5
#: Steps that no homography describes, and frames, after which a source counts for half.
BENDS, FRAMES = 8, 200


@dataclass(frozen=True, slots=True)
class Sketch:
    """A frame at small size.

    Attributes
    ----------
    colours : (h, w, 3) uint8
        BGR.
    gray : (h, w) uint8
    free : (h, w) uint8
        1 where nothing covers the background.
    """

    colours: Array
    gray: Array
    free: Array


def sketch_of(frame: Array, hidden: Array) -> Sketch:
    """Sketch a (H, W, 3) uint8 frame; ``hidden`` (H, W) uint8 is 1 where its background is covered."""
    height, width = hidden.shape
    scale = min(1.0, SKETCH_WIDTH / width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    colours = frame if scale == 1.0 else cv2.resize(frame, size, interpolation=cv2.INTER_AREA)
    covered = cv2.resize(hidden * np.uint8(255), size, interpolation=cv2.INTER_AREA)
    return Sketch(colours, cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY), (covered == 0).astype(np.uint8))


@dataclass(frozen=True, slots=True)
class _Step:
    """Motion from a frame to a neighbouring one.

    Attributes
    ----------
    matrix : (3, 3) float64
        Homography between their sketches.
    missed : (rows, columns, 2) float16 or None
        What must be added to the nodes before it, px; None if it is next to nothing.
    """

    matrix: Array
    missed: Array | None

    def followed(self, at: Array) -> Array:
        """Return where places (rows, columns, 2) float32 of the frame lie in the other."""
        if self.missed is not None:
            missed = self.missed.astype(np.float32)
            at = at + looked_up(missed, (at + 0.5) / CELL - 0.5, border=cv2.BORDER_REPLICATE)
        return placed(at, self.matrix)


class BackgroundMotion:
    """The motion of a clip's background; frames are added in order, then any two of them are related.

    It holds 29 kB a frame of 16:9, next to nothing where a homography describes the motion.
    """

    def __init__(self) -> None:
        self.poses: list[Pose] = []
        self.size = (0, 0)  # of the sketches: height, width
        self._path = CameraPath()
        self._ahead: list[_Step | None] = []  # from a frame to the next one
        self._back: list[_Step | None] = [None]  # … and to the one before
        self._bends = [0]  # steps up to a frame that no homography describes
        self._last: Sketch | None = None

    def add(self, frame: Array, sketch: Sketch) -> None:
        """Add the next frame, (H, W, 3) uint8 BGR."""
        height, width = self.size = sketch.gray.shape
        pose = self._path.place(frame, sketch.free, (width, height))
        if self._last is not None:
            before, last = self.poses[-1], self._last
            ahead = back = None
            if before.shot == pose.shot:
                ahead, back = _step(last, sketch, before.into(pose)), _step(sketch, last, pose.into(before))
            bends = any(step is not None and step.missed is not None for step in (ahead, back))
            self._bends.append(self._bends[-1] + int(bends))
            self._ahead.append(ahead)
            self._back.append(back)
        self.poses.append(pose)
        self._last = sketch

    def bends(self, first: int, last: int) -> int:
        """Return how many steps between two frames no homography describes."""
        return abs(self._bends[last] - self._bends[first])

    def nearness(self, index: int, other: int) -> float:
        """Return how well another frame of the same shot can be placed, 0 … 1: by steps that are not flat."""
        return 1.0 / ((1.0 + self.bends(index, other) / BENDS) * (1.0 + abs(other - index) / FRAMES))

    def places(self, index: int, nodes: Array, others: Sequence[int]) -> dict[int, Array]:
        """Find where the background at places of one frame lies in others.

        Parameters
        ----------
        index : int
            The frame.
        nodes : (rows, columns, 2) float32
            (x, y) in its sketch, px.
        others : sequence of int
            Those that are in another shot are left out of the result.

        Returns
        -------
        dict of int to (rows, columns, 2) float32
            Places in their sketches, which may lie outside.
        """
        result: dict[int, Array] = {}
        followed = []
        for other in others:
            if self.poses[other].shot != self.poses[index].shot:
                continue
            if abs(other - index) > FOLLOWED or not self.bends(index, other):
                result[other] = placed(nodes, self.poses[index].into(self.poses[other]))
            else:
                followed.append(other)
        for steps, way in ((self._ahead, 1), (self._back, -1)):
            wanted = {other for other in followed if (other - index) * way > 0}
            at, here = nodes, index
            while wanted:
                step = steps[here]
                assert step is not None  # all are of one shot
                at = step.followed(at)
                here += way
                if here in wanted:
                    result[here] = at
                    wanted.remove(here)
        return result


def nodes_of(region: Region) -> Array:
    """Return the nodes of a region of whole cells of a sketch, (rows, columns, 2) float32, px."""
    xs = region.x + CELL * np.arange(region.width // CELL, dtype=np.float32) + (CELL - 1) / 2
    ys = region.y + CELL * np.arange(region.height // CELL, dtype=np.float32) + (CELL - 1) / 2
    return np.stack(np.meshgrid(xs, ys), axis=-1)


def in_picture(points: Array, size: tuple[int, ...], other: tuple[int, ...]) -> Array:
    """Return where points (n, 2) of a picture (height, width, …) lie in the same at another size."""
    scale = np.array([other[1] / size[1], other[0] / size[0]])
    there: Array = ((points + 0.5) * scale - 0.5).astype(np.float32)
    return there


def to_pixels(nodes: Array) -> Array:
    """Interpolate values of nodes (rows, columns, n) at the sketch's pixels, (CELL·rows, CELL·columns, n)."""
    size = (CELL * nodes.shape[1], CELL * nodes.shape[0])
    pixels: Array = cv2.resize(nodes, size, interpolation=cv2.INTER_LINEAR)
    return pixels


def placed(points: Array, matrix: Array) -> Array:
    """Return where a homography takes points (…, 2), float32."""
    there: Array = cv2.perspectiveTransform(points.reshape(-1, 1, 2).astype(np.float64), matrix)
    return there.reshape(points.shape).astype(np.float32)


def _step(first: Sketch, second: Sketch, matrix: Array) -> _Step:
    """Measure the motion from one frame to a neighbouring one, ``matrix`` the homography between them."""
    height, width = first.gray.shape
    there = placed(_grid(width, height), matrix)
    seen = looked_up(second.gray, there, border=cv2.BORDER_REPLICATE)
    free = looked_up(second.free, there, cv2.INTER_NEAREST)
    missed = drift(first.gray, seen, (first.free & free) > 0, finest=1)
    missed = cv2.resize(missed, (-(-width // CELL), -(-height // CELL)), interpolation=cv2.INTER_AREA)
    flat = np.quantile(np.linalg.norm(missed, axis=-1), 0.95) < FLAT_PX
    return _Step(matrix, None if flat else missed.astype(np.float16))


def _grid(width: int, height: int) -> Array:
    """Return the places of pixels, (height, width, 2) float32."""
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)


def moved(places: Array, missed: Array) -> Array:
    """Look places (h, w, 2) up beside each pixel, ``missed`` (h, w, 2) px away from it."""
    grid = _grid(missed.shape[1], missed.shape[0])
    return looked_up(places, grid + missed, border=cv2.BORDER_REPLICATE)


def looked_up(
    picture: Array, there: Array, how: int = cv2.INTER_LINEAR, border: int = cv2.BORDER_CONSTANT
) -> Array:
    """Return a picture's values at places (h, w, 2) float32; outside of it ``border`` says, or 0."""
    values: Array = cv2.remap(picture, there, None, how, borderMode=border)  # type: ignore[call-overload]
    return values


def drift(target: Array, seen: Array, both: Array, finest: int = 0) -> Array:
    """Measure the flow between two pictures that nearly agree; where it is unknown, it is continued.

    Parameters
    ----------
    target, seen : (h, w) uint8
    both : (h, w) bool
        Where both show the background.
    finest : int
        How often the pictures are halved for the finest search.

    Returns
    -------
    (h, w, 2) float32
        From the target's pixels to those of the other, px.
    """
    height, width = both.shape
    if min(height, width) < LEAST_FLOW_PX or not both.any():
        return np.zeros((height, width, 2), np.float32)
    usable = both.astype(np.uint8)
    light = np.median(target[both].astype(np.int16) - seen[both])
    seen = np.clip(seen + light, 0, 255).astype(np.uint8)
    seen[~both] = target[~both]
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    search.setFinestScale(finest)
    search.setVariationalRefinementIterations(5 if finest else 0)
    flow = search.calc(target, seen, None)  # type: ignore[call-overload]
    misfit = cv2.absdiff(moved(seen, flow), target).astype(np.float32)
    kernel = np.ones((2 * DISBELIEVED_PX + 1,) * 2, np.uint8)
    weight: Array = cv2.erode(usable, kernel, borderValue=1).astype(np.float32)
    slope: Array = cv2.Sobel(target, cv2.CV_32F, 1, 0) ** 2 + cv2.Sobel(target, cv2.CV_32F, 0, 1) ** 2
    slope = cv2.blur(slope, (7, 7))
    weight *= (0.02 + slope / (slope + 900.0)) / (1.0 + (misfit / 10.0) ** 2) ** 2
    # Means of cells; those unlike the cells around them count less: what is in a hole hangs by few pixels.
    size = (-(-width // CELL), -(-height // CELL))
    part: Array = cv2.resize(weight, size, interpolation=cv2.INTER_AREA)
    mean: Array = cv2.resize(flow * weight[..., None], size, interpolation=cv2.INTER_AREA)
    mean /= np.maximum(part, 1e-6)[..., None]
    apart = np.linalg.norm(mean - continued(mean, part, floor=2.0), axis=-1)
    part /= (1.0 + (apart / APART_PX) ** 2) ** 2
    smooth = continued(mean, part.astype(np.float32), floor=0.1)
    drifted: Array = cv2.resize(smooth, (width, height), interpolation=cv2.INTER_LINEAR)
    return drifted


def continued(values: Array, weight: Array, floor: float) -> Array:
    """Continue values smoothly to where they have no weight.

    Averages over ever larger squares, of which each place takes the smallest that knows enough.

    Parameters
    ----------
    values : (h, w, n) float32
    weight : (h, w) float32
        0 … 1.
    floor : float
        How much weight in a square is enough.

    Returns
    -------
    (h, w, n) float32
    """
    levels = [np.dstack([values * weight[..., None], weight])]
    while min(levels[-1].shape[:2]) > 2:
        levels.append(cv2.pyrDown(levels[-1]))
    coarsest = levels[-1]
    result: Array = coarsest[..., :-1] / np.maximum(coarsest[..., -1:], 1e-6)
    for level in reversed(levels[:-1]):
        wider = cv2.resize(result, (level.shape[1], level.shape[0]), interpolation=cv2.INTER_LINEAR)
        result = (level[..., :-1] + floor * wider.reshape(*level.shape[:2], -1)) / (level[..., -1:] + floor)
    return result
