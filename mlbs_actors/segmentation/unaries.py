"""Unary costs of the graph cut: the first three terms of its energy (§7).

The costs of the layers' posteriors, the trajectories' own data cost, and the discount for cast shadows, in
quanta of the cut and for each label where it is allowed (:mod:`mlbs_actors.segmentation.segmenter` says how
they differ from the paper).
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.geometry.points_in_box import points_in_box
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import COST_STEP, Array
from mlbs_actors.segmentation.contrast import COST_QUANTUM

__all__ = ["discount_shadows", "proposed_costs", "track_pulls"]

#: Quanta of the graph cut in one of the layers' costs.
_QUANTA = np.int32(round(COST_STEP / COST_QUANTUM))


@compiled
def proposed_costs(
    cost: Array, own: Array, box: tuple[int, int, int, int], boxes: Array
) -> tuple[Array, Array]:
    """Return the costs of some layers in a box of cells.

    Parameters
    ----------
    cost, boxes
        Of :class:`~mlbs_actors.segmentation.group_labelling.Proposals`.
    own : (k,) int64
        Which of its layers.
    box : (left, top, width, height)
        Cells of ``cost``.

    Returns
    -------
    costs : (k, height, width) int32
        Of a pixel, ``COST_QUANTUM``; valid only where a layer has a proposal, outside which it owns nothing.
    places : (k, 4) int64
        That box: first row, row past the last, first column, column past the last.
    """
    left, top, width, height = box
    costs, places = np.empty((own.size, height, width), np.int32), np.empty((own.size, 4), np.int64)
    for label in range(own.size):
        place, proposal = places[label], boxes[own[label]]
        place[0], place[1] = max(proposal[0] - top, 0), min(proposal[1] - top, height)
        place[2], place[3] = max(proposal[2] - left, 0), min(proposal[3] - left, width)
        for y in range(place[0], place[1]):
            fused, row = cost[own[label], top + y], costs[label, y]
            for x in range(place[2], place[3]):
                row[x] = np.int32(fused[left + x]) * _QUANTA
    return costs, places


@compiled
def track_pulls(
    positions: Array, tracks: Array, places: Array, corner: tuple[int, int], shape: tuple[int, int], pull: int
) -> Array:
    """Compute the trajectories' data cost: −c for their own label at their pixel, +c for every other.

    Up to a constant that is −2c for their own: label, row, column and cost of each that lies in its label's
    place, which is given in pixels.
    """
    pulls = np.empty(((tracks[:, 1] - tracks[:, 0]).sum(), 4), np.int64)
    count = 0
    for label in range(len(tracks)):
        own = positions[tracks[label, 0] : tracks[label, 1]]
        top, bottom = places[label, 0] + corner[1], places[label, 1] + corner[1]
        left, right = places[label, 2] + corner[0], places[label, 3] + corner[0]
        # A trajectory outside the frame pulls at its border.
        inside = points_in_box(
            own,
            left if left > 0 else -np.inf,
            top if top > 0 else -np.inf,
            right if right < shape[1] else np.inf,
            bottom if bottom < shape[0] else np.inf,
        )
        for point in inside:
            x = min(max(int(np.rint(own[point, 0])), 0), shape[1] - 1) - corner[0]
            y = min(max(int(np.rint(own[point, 1])), 0), shape[0] - 1) - corner[1]
            pulls[count, 0], pulls[count, 1], pulls[count, 2], pulls[count, 3] = label, y, x, -pull
            count += 1
    return pulls[:count]


@compiled
def discount_shadows(
    costs: Array, places: Array, shadow: Array, lit: Array, strength: np.float32, least_body: float
) -> None:
    """Discount what an object costs less than the background in a shadow, and a little more.

    Parameters
    ----------
    costs, places
        Of :func:`proposed_costs`; the first label is the background. Changed in place.
    shadow, lit : (h, w) float32
        Of :func:`~mlbs_actors.segmentation.shadows.ground_likelihoods`.
    strength : float
        That little more, quanta.
    least_body : float
        Of all that costs less than the background and is not lit ground, the share that must be something
        else than shadow: with less nothing is there that could cast one, with twice as much it surely is.
    """
    body, dark = 0.0, 0.0
    claimed = np.zeros(shadow.shape, np.bool_)
    for label in range(1, costs.shape[0]):
        top, bottom, left, right = places[label]
        for y in range(top, bottom):
            for x in range(left, right):
                if costs[label, y, x] < costs[0, y, x] and not claimed[y, x]:
                    claimed[y, x] = True
                    body += 1.0 - shadow[y, x] - lit[y, x]
                    dark += shadow[y, x]
    caster = np.float32(1)
    if least_body * (body + dark) > 0.0:
        caster = np.float32(min(max(body / (least_body * (body + dark)) - 1.0, 0.0), 1.0))
    for label in range(1, costs.shape[0]):
        top, bottom, left, right = places[label]
        for y in range(top, bottom):
            own, background, darker = costs[label, y], costs[0, y], shadow[y]
            for x in range(left, right):
                at = np.uint64(x)
                lead = np.float32(max(background[at] - own[at], 0))
                own[at] += np.int32(np.rint(caster * darker[at] * (lead + strength)))
