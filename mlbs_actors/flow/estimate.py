"""The dense flow of a frame's cells, and the one place where its method is chosen (§3).

Differs from the paper: the authors use LDOF (tens of seconds a frame). Here ``flow.method`` names a search
that takes some milliseconds, our own or OpenCV's, or the caller hands in a function. Whichever it is, the
flow serves the trajectories, the layers' motion likelihood and the camera's motion alike.

Another method is another branch of :meth:`FlowEstimator.between`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.cells import mean_of_cells
from mlbs_actors.config import Config, FlowConfig, detail
from mlbs_actors.errors import FrameError
from mlbs_actors.flow.bidirectional_search import search_both_ways
from mlbs_actors.flow.consistency import DenseFlow, checked_flow
from mlbs_actors.flow.inverse_search import FlowLevel, coarsest_level, flow_levels
from mlbs_actors.flow.patch_search import PATCH
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array, Region
from mlbs_actors.wording import described

__all__ = [
    "LEAST_CELLS",
    "FlowEstimator",
    "FlowFunction",
    "Picture",
    "gray_levels",
    "picture_of",
]

#: A frame with fewer cells on a side has no flow: two patches.
LEAST_CELLS = 2 * PATCH

#: Pairs of frames whose flow is remembered: a frame that waits is compared with the last picture, the next
#: frame and the scenes that were left.
REMEMBERED = 6

#: Pictures whose levels are remembered: the last one, the new one, and one in new light.
REMEMBERED_LEVELS = 3

#: Maps two frames (H, W, 3) uint8 BGR to (H, W, 2) float: the displacement of each pixel from the first frame
#: to the second, px.
FlowFunction = Callable[[Array, Array], Array]


@dataclass(frozen=True, slots=True)
class Picture:
    """A frame in the form from which flow is estimated.

    Attributes
    ----------
    colours : (h, w, 3) uint8
        Mean colours of its cells, BGR.
    gray : (h, w) uint8
        Their grey levels, as the flow sees them.
    image : (H, W, 3) uint8
        BGR; empty unless the caller supplies the flow function.
    """

    colours: Array
    gray: Array
    image: Array


def gray_levels(colours: Array, shape: tuple[int, int]) -> Array:
    """Reduce colours to one value each, in which a frame of this size is followed.

    Parameters
    ----------
    colours : (n, m, 3) uint8
        BGR.
    shape : (int, int)
        (H, W) of the frame that they are from.

    Returns
    -------
    (n, m) uint8
        Their brightness; in a large frame, the mean of that and the brightest channel. What is small there
        may have few places that are brighter or darker than what is around it, and only its colour to go by.
    """
    gray: Array = cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY)
    if detail(*shape) == 1.0:
        return gray
    blue, green, red = cv2.split(colours)
    brightest = cv2.max(cv2.max(blue, green), red)
    mixed: Array = cv2.addWeighted(gray, 0.5, brightest, 0.5, 0.0)
    return mixed


def picture_of(frame: Array, side: int, whole: bool) -> Picture:
    """Prepare a (H, W, 3) uint8 BGR frame with cells of ``side`` px; keep all of it if ``whole``."""
    colours = mean_of_cells(frame, side)
    if detail(*frame.shape[:2]) > 1.0:
        gray = gray_levels(colours, frame.shape[:2])
    else:  # few pixels: they are rounded once, not twice
        gray = mean_of_cells(gray_levels(frame, frame.shape[:2]), side)
    return Picture(colours, gray, frame.copy() if whole else np.zeros((0, 0, 3), np.uint8))


class FlowEstimator:
    """Estimates the flow between pictures of one stream, both ways, and checks one by the other.

    What was computed of a picture, or asked of a caller's function for a pair, is remembered: the next
    picture is compared with the same one, and the function may cost more than all else. It takes neither
    boxes nor new light into account.

    Parameters
    ----------
    config : Config
    function : FlowFunction, optional
        The caller's own; it takes the place of ``flow.method``.
    """

    def __init__(self, config: Config, function: FlowFunction | None = None) -> None:
        self._config, self._function = config, function
        self._flows = deque[tuple[Array, Array, DenseFlow]](maxlen=REMEMBERED)
        self._levels = deque[tuple[Array, Sequence[FlowLevel]]](maxlen=REMEMBERED_LEVELS)

    def between(
        self, previous: Picture, current: Picture, side: int, focus: Sequence[Region] | None = None
    ) -> DenseFlow:
        """Estimate the flow from one picture to another.

        Parameters
        ----------
        previous, current : Picture
        side : int
            Of a cell, px.
        focus : sequence of Region, optional
            Disjoint boxes, in cells, beyond which the flow need not be fine; everywhere by default.

        Returns
        -------
        DenseFlow

        Raises
        ------
        FrameError
            If the caller's function does not return a flow.
        """
        config = self._config
        if self._function is not None:
            return self._asked(self._function, previous.image, current.image, side)
        if config.flow.method == "opencv":
            forward = _from_opencv(previous.gray, current.gray, side, config.flow)
            backward = _from_opencv(current.gray, previous.gray, side, config.flow)
        else:
            before, now = self._levels_of(previous.gray), self._levels_of(current.gray)
            planes = search_both_ways(before, now, config.flow, focus)
            forward, backward = (_interleaved(one, np.float32(side)) for one in planes)
        return checked_flow(forward, backward, side, config.trajectories)

    def _asked(self, function: FlowFunction, first: Array, second: Array, side: int) -> DenseFlow:
        for before, after, known in self._flows:
            if before is first and after is second:
                return known
        forward = _from_function(function, first, second, side)
        backward = _from_function(function, second, first, side)
        flow = checked_flow(forward, backward, side, self._config.trajectories)
        self._flows.append((first, second, flow))
        return flow

    def _levels_of(self, gray: Array) -> Sequence[FlowLevel]:
        for known, levels in self._levels:
            if known is gray:
                return levels
        levels = flow_levels(gray, coarsest_level(gray.shape))
        self._levels.append((gray, levels))
        return levels


@compiled
def _interleaved(planes: Array, factor: np.float32) -> Array:
    """Interleave planes (2, h, w) float32, times a factor, as (h, w, 2)."""
    _, height, width = planes.shape
    flow = np.empty((height, width, 2), np.float32)
    for y in range(height):
        for x in range(width):
            flow[y, x, 0], flow[y, x, 1] = factor * planes[0, y, x], factor * planes[1, y, x]
    return flow


def _from_opencv(first: Array, second: Array, side: int, config: FlowConfig) -> Array:
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    search.setFinestScale(config.finest_scale)
    flow: Array = search.calc(first, second, None)  # type: ignore[call-overload]
    return flow * np.float32(side)


def _from_function(function: FlowFunction, first: Array, second: Array, side: int) -> Array:
    returned = function(first, second)
    try:
        flow = np.asarray(returned)
    except (TypeError, ValueError, RuntimeError):  # lists of several lengths, a tensor on another device
        flow = np.asarray(None)
    if flow.shape != (*first.shape[:2], 2) or not np.issubdtype(flow.dtype, np.floating):
        raise FrameError(
            f"The flow function returned {described(returned)}; it must return the motion in px of each "
            f"pixel of the first frame, {(*first.shape[:2], 2)} float32."
        )
    if not np.isfinite(flow).all():
        raise FrameError("The flow function returned NaN or infinite motion; give 0 where none is known.")
    return mean_of_cells(np.ascontiguousarray(flow, np.float32), side)
