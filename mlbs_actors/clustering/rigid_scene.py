"""Depth is not motion: what moves as a part of one rigid scene could is background (§4).

Not in the paper, which has no camera model. A homography (:mod:`mlbs_actors.tracking.camera`) stands for the
camera's motion here, and what is nearer than the plane that it describes moves against it: a rock, a wall,
the near bank of a river, a guard rail. Over some frames one essential matrix explains all that is static,
with a depth for each point. It is fitted to three sets of trajectories, as each can mislead:

* *The background's and one label's.* It explains an object as well, if that moves evenly before a plane. But
  an object is mostly surrounded by the background, while near parts of the scene reach out of the frame. So a
  large young label of whose outline a part is the frame's border is background, unless the matrix fails for
  it or for the background.
* *All.* A single label hardly bends it. A young label for which this matrix or the first fails, but not for
  the background, moves by itself, even if it is slower than the background's own parallax.
* *The background's.* It is well determined only if the background has depth, so that a homography explains
  clearly less of it. Then what it explains in front of the camera is static, wherever it lies, unless a
  matrix that is fitted to half of the background fails for it. Of the cars beside a driving camera that keep
  its pace it says that they are behind infinity.

The focal length is taken to be ``FOCAL`` of the longer side: between 0.7 and 1.8 the outcome is much the
same.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.clustering.label_index import distinct_labels
from mlbs_actors.config import LayersConfig, length_scale
from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.tracking.trajectories import evenly_spread

__all__ = ["Places", "border_share", "judge_by_depth", "scene_squares", "taken_squares"]

#: Focal length, × the longer side of the frame.
FOCAL = 1.1
#: Confidence that the best matrix was found, and most samples drawn for it.
CONFIDENCE, MOST_SAMPLES = 0.999, 1000
#: Distance to the epipolar line of a point that obeys, px, and what is added to it, × its parallax.
INLIER_PX, INLIER_RELATIVE = 1.0, 0.02
#: Distance within which a homography explains a point, px: errors along the line count as well.
PLANE_PX = 1.5
#: What is static has at most so many px of parallax towards the wrong side; which one that is, is known if so
#: much of the background is on the right one.
BEHIND_PX, IN_FRONT = 2.0, 0.95
#: Least number of points that stand for the background.
LEAST_BACKGROUND = 20
#: Spacing of the points that stand for the background and for a label, px.
BACKGROUND_SPACING_PX, SPACING_PX = 20.0, 12.0
#: Side of the squares of which an outline is made, px, and fewest of them.
SQUARE_PX, LEAST_SQUARES = 24.0, 4
#: A square of which so much is fixed in the picture shows none of the scene.
MOST_FIXED = 0.5


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
    fixed: Array,
    shape: tuple[int, int],
    config: LayersConfig,
) -> tuple[set[int], set[int]]:
    """Tell static parts of the scene, and what moves by itself, from how one rigid scene holds them.

    Parameters
    ----------
    places : sequence of Places
        In the last pictures, newest first; the newest and the oldest are compared.
    labels : (n,) int64
        Of the newest.
    young : collection of int
        Labels of which it is not known whether they move.
    slow : collection of int
        Labels, young or not, that seem to rest.
    fixed : (h, w) bool
        Cells that are fixed in the picture: the scene ends at a bonnet as at the frame's border.
    shape : (int, int)
        (H, W) of the frame.

    Returns
    -------
    static : set of int
        Labels, young or not, that seem to move only because they are near.
    moving : set of int
        Young slow labels that move by themselves.
    """
    static, scene = set(), scene_squares(fixed, shape)
    for label in young:
        taken = taken_squares(places[0].positions[labels == label], shape)
        if taken.mean() >= config.scene_area and border_share(taken, scene) > config.scene_border:
            static.add(label)
    pairs = _Pairs.between(places[-1], places[0], labels, shape)
    background = pairs.spread([BACKGROUND], BACKGROUND_SPACING_PX)
    if len(background) < LEAST_BACKGROUND:
        return static, set()
    judged = {label for label in distinct_labels(pairs.labels) if pairs.count(label) >= config.min_tracks}
    judged -= {BACKGROUND}
    resting = judged.intersection(young).intersection(slow)
    left, moving = _by_single_labels(pairs, background, resting, static & judged, config)
    static -= left
    background = pairs.spread([BACKGROUND, *static], BACKGROUND_SPACING_PX)
    moving |= _by_all(pairs, background, resting - static, static, config)
    static |= _by_background(pairs, background, judged - static - set(slow), config)
    return static, moving


def _by_single_labels(
    pairs: _Pairs, background: Array, resting: set[int], at_border: set[int], config: LayersConfig
) -> tuple[set[int], set[int]]:
    """Return the labels at the border that are no parts of the scene, and the resting ones that move."""
    left, moving = set(), set()
    for label in sorted(resting | at_border):
        obeys = _obeying(pairs, np.concatenate((background, pairs.spread([label], SPACING_PX))))
        if obeys is None:
            continue
        own, others = pairs.share(obeys, label), float(obeys[background].mean())
        if min(own, others) < config.scene_obeying:
            left.add(label)
        if label in resting and own < config.scene_contradicted and others >= config.scene_obeying:
            moving.add(label)
    return left, moving


def _by_all(
    pairs: _Pairs, background: Array, resting: set[int], static: set[int], config: LayersConfig
) -> set[int]:
    """Return the resting labels that the matrix of all trajectories leaves."""
    if not resting:
        return set()
    others = pairs.spread(distinct_labels(pairs.labels) - static - {BACKGROUND}, SPACING_PX)
    obeys = _obeying(pairs, np.concatenate((background, others)))
    if obeys is None or obeys[background].mean() < config.scene_obeying:
        return set()
    return {label for label in resting if pairs.share(obeys, label) < config.scene_contradicted}


def _by_background(pairs: _Pairs, background: Array, fast: set[int], config: LayersConfig) -> set[int]:
    """Return the labels that are static by the background's own matrix; none if it has no depth.

    If it has little, many matrices explain it, and chance decides which of them is found: of an object that
    moves by itself, the matrix of one half of the background explained everything, that of the other half
    nothing. So a matrix is fitted to each half as well. It must explain the background as that of all does,
    or no label is static, and at least ``scene_contradicted`` of a label, or that label is not.
    """
    if not fast:
        return set()
    flat = _obeying_homography(pairs, background)
    if flat >= 1.0 - config.scene_depth:  # depth cannot explain so much more
        return set()
    static = set(fast)
    halves = [(half, config.scene_contradicted) for half in (background[::2], background[1::2])]
    for fitted, least in ((background, config.scene_obeying), *halves):
        obeys = _obeying(pairs, fitted, in_front=True)
        if obeys is None or obeys[background].mean() <= max(config.scene_obeying, flat + config.scene_depth):
            return set()
        static = {label for label in static if pairs.share(obeys, label) >= least}
        if not static:
            break
    return static


@dataclass(frozen=True, slots=True)
class _Pairs:
    """The trajectories that are in two pictures.

    Attributes
    ----------
    now, before : (m, 2) float64
        Their places, px.
    labels : (m,) int64
    camera : (3, 3) float64
        Takes directions to px.
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.
    """

    now: Array
    before: Array
    labels: Array
    camera: Array
    scale: float

    @classmethod
    def between(cls, before: Places, now: Places, labels: Array, shape: tuple[int, int]) -> _Pairs:
        _, at, there = np.intersect1d(now.ids, before.ids, assume_unique=True, return_indices=True)
        focal = FOCAL * max(shape)
        camera = np.array([[focal, 0, shape[1] / 2], [0, focal, shape[0] / 2], [0, 0, 1]])
        ends, starts = now.positions[at].astype(np.float64), before.positions[there].astype(np.float64)
        return cls(ends, starts, labels[at], camera, length_scale(*shape))

    def count(self, label: int) -> int:
        return int((self.labels == label).sum())

    def spread(self, labels: Collection[int], spacing: float) -> Array:
        """Return indices (k,) of trajectories of some labels, at most one a square."""
        chosen = np.isin(self.labels, list(labels))
        return evenly_spread(self.now.astype(np.float32), chosen, spacing * self.scale)

    def share(self, obeys: Array, label: int) -> float:
        """Return the share of a label's trajectories that obey, (m,) bool."""
        return float(obeys[self.labels == label].mean())


def taken_squares(positions: Array, shape: tuple[int, int]) -> Array:
    """Squares of the frame that hold some trajectories.

    Parameters
    ----------
    positions : (n, 2) float32
        px.
    shape : (int, int)
        (H, W) of the frame.

    Returns
    -------
    (rows, columns) bool
    """
    rows, columns = _squares_of(shape)
    y = np.clip((positions[:, 1] * rows / shape[0]).astype(np.intp), 0, rows - 1)
    x = np.clip((positions[:, 0] * columns / shape[1]).astype(np.intp), 0, columns - 1)
    taken = np.zeros((rows, columns), bool)
    taken[y, x] = True
    return taken


def scene_squares(fixed: Array, shape: tuple[int, int]) -> Array:
    """Squares of the frame that show the scene, (rows, columns) bool; parameters as of `judge_by_depth`."""
    rows, columns = _squares_of(shape)
    share = cv2.resize(fixed.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(share < MOST_FIXED)


def _squares_of(shape: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of squares in a frame."""
    side = SQUARE_PX * length_scale(*shape)
    rows, columns = (max(round(length / side), 3) for length in shape)
    return rows, columns


def border_share(taken: Array, scene: Array) -> float:
    """Share of an outline that is the border of what shows the scene.

    Parameters
    ----------
    taken, scene : (rows, columns) bool
        Of :func:`taken_squares` and :func:`scene_squares`.

    Returns
    -------
    float
        0 to 1, of the taken squares that are not surrounded by such; 0 if those are few.
    """
    outline = taken & ~_surrounded(taken)
    if outline.sum() < LEAST_SQUARES:
        return 0.0
    return float((outline & ~_surrounded(scene)).sum() / outline.sum())


def _surrounded(squares: Array) -> Array:
    """Which squares have all four beside them in the frame, and such as they are."""
    inner = np.zeros_like(squares)
    inner[1:-1, 1:-1] = squares[:-2, 1:-1] & squares[2:, 1:-1] & squares[1:-1, :-2] & squares[1:-1, 2:]
    return squares & inner


def _obeying(pairs: _Pairs, chosen: Array, *, in_front: bool = False) -> Array | None:
    """Tell which trajectories obey the essential matrix of some of them.

    Parameters
    ----------
    pairs : _Pairs
    chosen : (k,) intp
    in_front : bool
        Whether they must not be behind infinity either, if it is known on which side that is.

    Returns
    -------
    (m,) bool, or None
        None if there is no matrix.
    """
    ends, starts = pairs.now[chosen], pairs.before[chosen]
    try:
        essential, inliers = cv2.findEssentialMat(
            ends, starts, pairs.camera, cv2.USAC_MAGSAC, CONFIDENCE, INLIER_PX * pairs.scale, MOST_SAMPLES
        )
    except cv2.error:  # with points in random motion OpenCV may find no matrix, and fail on that
        return None
    if essential is None or essential.shape != (3, 3):
        return None
    _, rotation, translation, _ = cv2.recoverPose(essential, ends, starts, pairs.camera, mask=inliers)
    # Where points at infinity would have come from, and which way nearer ones did.
    turned = pairs.camera @ rotation @ np.linalg.inv(pairs.camera)
    farthest = cv2.perspectiveTransform(pairs.now[None], turned)[0]
    epipole = (pairs.camera @ translation).ravel()
    towards = epipole[:2] - epipole[2] * farthest
    towards /= np.maximum(np.hypot(*towards.T), 1e-9)[:, None]
    parallax = pairs.before - farthest
    off = np.abs(parallax[:, 0] * towards[:, 1] - parallax[:, 1] * towards[:, 0])
    obeys = np.asarray(off < INLIER_PX * pairs.scale + INLIER_RELATIVE * np.hypot(*parallax.T))
    along = (parallax * towards).sum(axis=1)
    if in_front and (along[chosen] > -INLIER_PX * pairs.scale).mean() >= IN_FRONT:
        obeys &= along > -BEHIND_PX * pairs.scale
    return obeys


def _obeying_homography(pairs: _Pairs, chosen: Array) -> float:
    """Return the share of some trajectories (k,) that one homography explains.

    By MAGSAC, like the essential matrix, but with OpenCV's own limits. Plain RANSAC stops at the first
    homography that is good enough: of planes that one homography explains to 92 to 100 %, it explained 73 to
    95 %, so that they were taken to have depth.
    """
    ends, starts = pairs.now[chosen], pairs.before[chosen]
    matrix, inliers = cv2.findHomography(ends, starts, cv2.USAC_MAGSAC, PLANE_PX * pairs.scale)
    return 0.0 if matrix is None else float(inliers.mean())
