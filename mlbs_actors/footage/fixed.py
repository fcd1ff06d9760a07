"""What is fixed in the picture and not in the scene: clocks, names, logos, bars, a bonnet, dirt.

It stays where it is, to the fraction of a pixel, while the camera's motion would have moved it. On an edge
that shows within a few frames: what an object does that the camera follows looks alike for one frame or two,
but no longer. Flat parts show nothing by themselves; they belong to the edges that surround them, as long as
they do not change either. The sky does not change, but its border moves. Bars are black rows or columns at
the border.

Fixed cells take no part in what the scene does: no trajectory begins or goes on there, the flow there is not
reliable, nothing is learnt from them, and they belong to the background.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["FixedState", "fixed_cells"]

#: A cell stays if it differs by at most ``MOST_CHANGE`` from what it was, and the camera's motion does not
#: explain it if that leaves at least ``LEAST_DIFFERENCE``, grey levels.
MOST_CHANGE, LEAST_DIFFERENCE = 8, 14
#: Least range of the grey levels of a cell and its neighbours: on an edge.
LEAST_EDGE = 24
#: On a sharp edge, which text and signs have, a small motion shows at once: a frame counts more where the
#: range and the difference are at least these, and the change is at most this.
SHARP_EDGE, SHARP_DIFFERENCE, SHARP_CHANGE = 80, 30, 3
#: Votes of a frame, and of one on a sharp edge; those with which a cell is fixed, the most that are
#: remembered, and those that a frame takes back in which the cell moves as the camera does.
FRAME_VOTES, SHARP_VOTES, VOTES, MOST_VOTES, TAKEN_BACK = 2, 5, 20, 40, 6
#: Rows and columns of the border up to this grey level are bars, if at least this share of the next two is
#: lighter: of 2,812 borders of pictures all but the black ones are to a quarter. A night is black to the
#: border, too.
MOST_BLACK, LEAST_LIT = 24, 0.2
#: A part is unchanging if it has not changed for so many frames.
UNCHANGING = 4
#: Cells on an edge without so many others among the 24 around them are chance.
LEAST_COMPANY = 3
#: Gaps up to this width between fixed cells are closed, and all are widened by this, cells.
GAP, MARGIN = 9, 2
#: Least share of the border of an unchanging part that is fixed if the part is, and the largest such part, as
#: a share of the picture: of a camera that stands still nearly all is unchanging.
LEAST_ENCLOSED, LARGEST_ENCLOSED = 0.5, 0.5


@dataclass(frozen=True, slots=True)
class FixedState:
    """What is remembered of each cell.

    Attributes
    ----------
    reference : (h, w) uint8
        Its grey level when it changed last.
    votes : (h, w) int8
        For its being fixed, up to ``MOST_VOTES``.
    still : (h, w) uint8
        Frames since it changed.
    ignored : (h, w) bool
        What is said to be fixed.
    cells : (h, w) bool
        What is fixed, with what is said to be.
    """

    reference: Array
    votes: Array
    still: Array
    ignored: Array
    cells: Array

    @staticmethod
    def beginning(gray: Array, ignored: Array | None = None) -> FixedState:
        """In an epoch's first picture (h, w) uint8; ``ignored``, a mask of any size, is scaled to it."""
        cells = np.zeros(gray.shape, bool)
        if ignored is not None:
            mask, size = ignored.astype(np.uint8), (gray.shape[1], gray.shape[0])
            cells = cv2.resize(255 * mask, size, interpolation=cv2.INTER_AREA) > 0
        return FixedState(gray, np.zeros(gray.shape, np.int8), np.zeros(gray.shape, np.uint8), cells, cells)


def fixed_cells(state: FixedState, gray: Array, difference: Array) -> FixedState:
    """Go on to a picture.

    Parameters
    ----------
    state : FixedState
    gray : (h, w) uint8
        The picture.
    difference : (h, w) uint8
        What the camera's motion leaves of each cell, grey levels; 0 where it leads from outside the frame.

    Returns
    -------
    FixedState
    """
    kernel = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(gray, kernel) - cv2.erode(gray, kernel)
    reference, votes, still = _voted(state.reference, state.votes, state.still, gray, difference, edge)
    voted = votes >= VOTES
    cells = state.ignored | _bars(gray)
    if voted.any():
        cells |= _completed(voted, still >= UNCHANGING)
    return FixedState(reference, votes, still, state.ignored, cells)


@compiled
def _voted(
    reference: Array, votes: Array, still: Array, gray: Array, difference: Array, edge: Array
) -> tuple[Array, Array, Array]:
    reference, votes, still = reference.copy(), votes.copy(), still.copy()
    for y in range(gray.shape[0]):
        for x in range(gray.shape[1]):
            change = abs(np.int16(gray[y, x]) - np.int16(reference[y, x]))
            if change <= MOST_CHANGE:
                still[y, x] = min(still[y, x] + 1, 255)
                if difference[y, x] >= LEAST_DIFFERENCE and edge[y, x] >= LEAST_EDGE:
                    sharp = difference[y, x] >= SHARP_DIFFERENCE and edge[y, x] >= SHARP_EDGE
                    sharp &= change <= SHARP_CHANGE
                    votes[y, x] = min(votes[y, x] + (SHARP_VOTES if sharp else FRAME_VOTES), MOST_VOTES)
                continue
            reference[y, x], still[y, x] = gray[y, x], 0
            if votes[y, x] < VOTES:
                votes[y, x] = 0
            elif difference[y, x] < LEAST_DIFFERENCE:
                votes[y, x] -= TAKEN_BACK
    return reference, votes, still


def _bars(gray: Array) -> Array:
    """Black rows and columns at the border, where the picture begins with them all along."""
    light, cells = gray > MOST_BLACK, np.zeros(gray.shape, bool)
    for lit, along in ((light, cells), (light.T, cells.T)):
        places = np.flatnonzero(lit.any(axis=1))
        if not places.size:
            continue
        first, last = places[0], places[-1]
        if first > 0 and lit[first : first + 2].any(axis=0).mean() >= LEAST_LIT:
            along[: first + MARGIN] = True
        if last < len(lit) - 1 and lit[last - 1 : last + 1].any(axis=0).mean() >= LEAST_LIT:
            along[last + 1 - MARGIN :] = True
    return cells


def _completed(voted: Array, unchanging: Array) -> Array:
    """What is fixed, by its edges: what lies between them, and the unchanging parts that they surround."""
    company = cv2.boxFilter(voted.astype(np.uint8), cv2.CV_8U, (5, 5), normalize=False)
    seeds = (voted & (company > LEAST_COMPANY)).astype(np.uint8)
    closed = cv2.morphologyEx(seeds, cv2.MORPH_CLOSE, np.ones((GAP, GAP), np.uint8))
    closed = cv2.dilate(closed, np.ones((3, 3), np.uint8))
    count, parts = cv2.connectedComponents((unchanging & (closed == 0)).astype(np.uint8), connectivity=4)
    # The border of each part: cells beside it, in the frame; and those of them that are fixed.
    border, fixed = np.zeros(count, np.int64), np.zeros(count, np.int64)
    for own, beside, other in (
        (parts[:, :-1], closed[:, 1:], parts[:, 1:]),
        (parts[:, 1:], closed[:, :-1], parts[:, :-1]),
        (parts[:-1], closed[1:], parts[1:]),
        (parts[1:], closed[:-1], parts[:-1]),
    ):
        at_border = (own > 0) & (other != own)
        border += np.bincount(own[at_border], minlength=count)
        fixed += np.bincount(own[at_border & (beside > 0)], minlength=count)
    enclosed = (fixed > 0) & (fixed >= LEAST_ENCLOSED * border)
    enclosed &= np.bincount(parts.reshape(-1), minlength=count) <= LARGEST_ENCLOSED * parts.size
    enclosed[0] = False
    cells = np.where(enclosed[parts], np.uint8(1), closed)
    return cv2.dilate(cells, np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)) > 0
