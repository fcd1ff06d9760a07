"""Depth is not motion: what reaches the frame's border, and moves as a part of the scene could (§4).

Not in the paper, which has no camera model. A homography (:mod:`mlbs_actors.tracking.camera`) stands for the
camera's motion here, and what is nearer than the plane that it describes moves against it: a rock, a wall,
the near bank of a river. Over some frames one essential matrix explains such a part and the background
together, with a depth for each point. It explains an object as well if that moves evenly before a plane, so
that alone refuses too much. But an object is mostly surrounded by the background, while near parts of the
scene reach out of the frame. So a large young label of whose outline a part is the frame's border is
background, unless the matrix fails for it or for the background. A young label for which it fails, and not
for the background, moves by itself, even if it is slower than the background's own parallax.

The focal length is taken to be ``FOCAL`` of the longer side: between 0.7 and 1.8 the outcome is much the
same.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.config import LayersConfig, length_scale
from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.tracking.trajectories import evenly_spread

__all__ = ["Places", "border_share", "judge_by_depth", "obeying_shares"]

#: Focal length, × the longer side of the frame.
FOCAL = 1.1
#: Confidence that the best matrix was found, and most samples drawn for it.
CONFIDENCE, MOST_SAMPLES = 0.999, 1000
#: Distance to the epipolar line of a point that obeys, px, and what is added to it, × its parallax.
INLIER_PX, INLIER_RELATIVE = 1.0, 0.02
#: Least number of trajectories of a label, and of the background, to be judged.
LEAST_TRACKS, LEAST_BACKGROUND = 8, 20
#: Spacing of the points that stand for the background and for a label, px.
BACKGROUND_SPACING_PX, SPACING_PX = 20.0, 12.0
#: Side of the squares of which an outline is made, px, and fewest of them.
SQUARE_PX, LEAST_SQUARES = 24.0, 4


@dataclass(frozen=True, slots=True)
class Places:
    """Where the trajectories were in one picture.

    Attributes
    ----------
    ids : (n,) int64
        Ascending.
    positions : (n, 2) float32
        px.
    """

    ids: Array
    positions: Array


def judge_by_depth(
    places: Sequence[Places],
    labels: Array,
    young: Collection[int],
    slow: Collection[int],
    shape: tuple[int, int],
    config: LayersConfig,
) -> tuple[list[int], list[int]]:
    """Tell static parts of the scene, and what moves by itself, from how one rigid scene holds them.

    Parameters
    ----------
    places : sequence of Places
        In the last pictures, newest first; the newest and the oldest are compared.
    labels : (n,) int64
        Of the newest.
    young : collection of int
        Labels that may be parts of the scene.
    slow : collection of int
        Those of them that seem to rest.
    shape : (int, int)
        (H, W) of the frame.

    Returns
    -------
    static : list of int
        Labels that reach the frame's border and could be static parts of the scene; ascending.
    moving : list of int
        Slow labels that no depth explains, while one rigid scene holds the background; ascending.
    """
    at_border = {
        label
        for label in young
        if _area_share(places[0].positions, labels == label, shape) >= config.scene_area
        and border_share(places[0].positions[labels == label], shape) > config.scene_border
    }
    shares = obeying_shares(places[-1], places[0], labels, sorted(at_border.union(slow)), shape)
    static = [one for one in sorted(at_border) if min(shares.get(one, (1.0, 1.0))) >= config.scene_obeying]
    moving = [
        label
        for label, (own, background) in shares.items()
        if label in slow and own < config.scene_contradicted and background >= config.scene_obeying
    ]
    return static, moving


def _area_share(positions: Array, own: Array, shape: tuple[int, int]) -> float:
    """Share of the frame's squares that hold trajectories of a label."""
    side = SQUARE_PX * length_scale(*shape)
    return len(evenly_spread(positions, own, side)) * side**2 / (shape[0] * shape[1])


def border_share(positions: Array, shape: tuple[int, int]) -> float:
    """Share of the outline of some trajectories that is the frame's border.

    Parameters
    ----------
    positions : (n, 2) float32
        px.
    shape : (int, int)
        (H, W) of the frame.

    Returns
    -------
    float
        0 to 1, of the squares with trajectories that are not surrounded by such; 0 if those are few.
    """
    side = SQUARE_PX * length_scale(*shape)
    rows, columns = (max(round(length / side), 3) for length in shape)
    y = np.clip((positions[:, 1] * rows / shape[0]).astype(np.intp), 0, rows - 1)
    x = np.clip((positions[:, 0] * columns / shape[1]).astype(np.intp), 0, columns - 1)
    taken = np.zeros((rows, columns), bool)
    taken[y, x] = True
    inner = np.zeros_like(taken)
    inner[1:-1, 1:-1] = taken[:-2, 1:-1] & taken[2:, 1:-1] & taken[1:-1, :-2] & taken[1:-1, 2:]
    outline = taken & ~inner
    if outline.sum() < LEAST_SQUARES:
        return 0.0
    inside = outline[1:-1, 1:-1].sum()
    return float(1.0 - inside / outline.sum())


def obeying_shares(
    before: Places, now: Places, labels: Array, wanted: list[int], shape: tuple[int, int]
) -> dict[int, tuple[float, float]]:
    """Tell how well one rigid scene holds the background and a label.

    Parameters
    ----------
    before, now : Places
        Some pictures apart.
    labels : (n,) int64
        Of ``now``.
    wanted : list of int
        Labels to judge.
    shape : (int, int)
        (H, W) of the frame.

    Returns
    -------
    dict of int to (float, float)
        Label → the shares of its trajectories and of the background's that obey the essential matrix of both;
        without the labels that cannot be judged.
    """
    if not wanted:
        return {}
    _, at, there = np.intersect1d(now.ids, before.ids, assume_unique=True, return_indices=True)
    scale, focal = length_scale(*shape), FOCAL * max(shape)
    camera = np.array([[focal, 0, shape[1] / 2], [0, focal, shape[0] / 2], [0, 0, 1]])
    positions, labels = now.positions[at], labels[at]
    ends, starts = positions.astype(np.float64), before.positions[there].astype(np.float64)
    background = evenly_spread(positions, labels == BACKGROUND, BACKGROUND_SPACING_PX * scale)
    if len(background) < LEAST_BACKGROUND:
        return {}
    shares = {}
    for label in wanted:
        own = labels == label
        if own.sum() < LEAST_TRACKS:
            continue
        chosen = np.concatenate((background, evenly_spread(positions, own, SPACING_PX * scale)))
        obeys = _obeying(ends, starts, chosen, camera, scale)
        if obeys is not None:
            shares[label] = float(obeys[own].mean()), float(obeys[background].mean())
    return shares


def _obeying(now: Array, before: Array, chosen: Array, camera: Array, scale: float) -> Array | None:
    """Return which points (n, 2) px obey the essential matrix of the chosen ones; None if there is none."""
    ends, starts = now[chosen], before[chosen]
    try:
        essential, inliers = cv2.findEssentialMat(
            ends, starts, camera, cv2.USAC_MAGSAC, CONFIDENCE, INLIER_PX * scale, MOST_SAMPLES
        )
    except cv2.error:  # with points in random motion OpenCV may find no matrix, and fail on that
        return None
    if essential is None or essential.shape != (3, 3):
        return None
    _, rotation, translation, _ = cv2.recoverPose(essential, ends, starts, camera, mask=inliers)
    # Where points at infinity would have come from, and which way nearer ones did.
    turned = camera @ rotation @ np.linalg.inv(camera)
    farthest = cv2.perspectiveTransform(now[None], turned)[0]
    epipole = (camera @ translation).ravel()
    towards = epipole[:2] - epipole[2] * farthest
    parallax = before - farthest
    off = np.abs(parallax[:, 0] * towards[:, 1] - parallax[:, 1] * towards[:, 0])
    off /= np.maximum(np.hypot(*towards.T), 1e-9)
    return np.asarray(off < INLIER_PX * scale + INLIER_RELATIVE * np.hypot(*parallax.T))
