"""Depth is not motion: how likely each label is a part of one rigid scene (§4).

Not in the paper, which has no camera model. A homography (:mod:`mlbs_actors.tracking.camera`) stands for the
camera's motion here, and what is nearer than the plane that it describes moves against it: a post, a rock, a
wall, a guard rail. Over some frames one essential matrix explains all that is static, with a depth for each
point. Such a matrix is fitted to the trajectories of *all* labels that may be static, and not to the
background's only: where a scene has much depth, the background of the first clustering is a piece of it.

Nothing here decides. Each sign is a log-likelihood ratio that was measured (docs/experiments/camera.md), that
a label is static and not moving by itself:

* *Its motion.* The share of its trajectories that obey the matrix, in front of the camera. It says the more,
  the better the matrix explains the others than a homography does: before a plane it is arbitrary, and bends
  to whatever moves evenly. So matrices of a quarter of the points each are asked, and the more depth the
  others have, the more is a label that covers much judged by the matrices of these alone.
* *Where it lies.* Of the outline of near parts of the scene a part is the frame's border; an object is mostly
  surrounded.
* *Its speed* against the homography.
* *The scene.* The less of the others one plane explains, the more labels are parts of it.

The focal length is taken to be ``FOCAL`` of the longer side.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.clustering.label_index import UNLABELLED, distinct_labels
from mlbs_actors.clustering.outline import border_share, scene_squares, taken_squares
from mlbs_actors.config import LayersConfig, length_scale
from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.tracking.trajectories import evenly_spread

__all__ = ["Places", "SceneEvidence", "scene_evidence"]

#: Places, ascending, and values of a curve that is linear in between.
_Curve = tuple[tuple[float, ...], tuple[float, ...]]

#: Focal length, × the longer side of the frame.
FOCAL = 1.1
#: Confidence that the best matrix was found, and most samples drawn for it.
CONFIDENCE, MOST_SAMPLES = 0.999, 1000
#: Distance to the epipolar line of a point that obeys, px, and what is added to it, × its parallax; to be
#: static, no more than that of so much parallax, px.
INLIER_PX, INLIER_RELATIVE, MOST_PARALLAX_PX = 1.0, 0.02, 50.0
#: Distance within which a homography explains a point, px: errors along the line count as well.
PLANE_PX = 1.5
#: What is static has at most so many px of parallax towards the wrong side.
BEHIND_PX = 2.0
#: Fewest points to which matrices are fitted, into how many parts they are divided, and their spacing, px.
LEAST_POINTS, PARTS, SPACING_PX = 20, 4, 20.0
#: So many of them tell on which side of the camera they are.
SIDE_POINTS = 50
#: From this share of the points on, a label is large, and bends a matrix that is fitted to it.
LARGE = 0.05
# Log-likelihood ratios, nats.
#: Of the share of a label's trajectories that obey, × the lowest or the highest value.
OBEYING = (0.05, 0.18, 0.45, 0.65, 0.85), (-1.0, -0.6, 0.0, 0.5, 1.0)
#: These values, by the depth of the others: by how much more of them the matrix explains than a plane does.
LOWEST, HIGHEST = ((0.05, 0.3), (-0.5, -2.6)), ((0.05, 0.3), (0.3, 2.6))
#: The same for a large label, by the matrix that is fitted to it as well.
LARGE_LOWEST, LARGE_HIGHEST = ((0.05, 0.2), (-0.5, -1.8)), ((0.03, 0.1), (0.2, 1.6))
#: The weight of the matrix of the others alone for a large label, by their depth.
OTHERS_WEIGHT = (0.1, 0.25), (0.0, 1.0)
#: Of the share of its outline that is the frame's border, and that of a label of less than this share of the
#: frame, whose outline is a few squares.
BORDER, SMALL_BORDER, SMALL = ((0.0, 0.05, 0.3, 0.5), (-1.2, 0.8, 1.1, 2.8)), ((0.0, 0.05), (-0.4, 1.0)), 0.01
#: Of its area, × the part of the second curve for its border.
AREA, AREA_BORDER = ((0.1, 0.25), (0.0, 1.0)), ((0.1, 0.4), (0.0, 1.0))
#: Of the binary logarithm of its speed, × the least one of an object.
SPEED = (-1.5, -0.5, 0.0, 1.0, 1.5, 3.0, 4.0), (3.5, 2.2, 1.3, 0.5, 0.1, -0.6, -1.0)
#: Log-odds that a label is static, by the share of the others that a plane explains; where that is not known.
PRIOR, UNKNOWN_PRIOR = ((0.66, 0.97), (1.0, -1.8)), -0.5


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


@dataclass(frozen=True, slots=True)
class SceneEvidence:
    """How likely labels are static, in nats: positive for a part of the scene.

    Attributes
    ----------
    motion : dict of int to float
        Label → log-likelihood ratio of its motion in the last pictures; without those of which nothing is
        known. It is worth gathering: every clustering sees other pictures.
    standing : dict of int to float
        Label → log-odds by all else, which changes little from one clustering to the next.
    """

    motion: dict[int, float]
    standing: dict[int, float]


def scene_evidence(
    places: Sequence[Places],
    labels: Array,
    objects: Collection[int],
    speeds: Mapping[int, float],
    fixed: Array,
    shape: tuple[int, int],
    config: LayersConfig,
) -> SceneEvidence:
    """Weigh for every label whether it is a part of one rigid scene.

    Parameters
    ----------
    places : sequence of Places
        In the last pictures, newest first. The newest and the oldest are compared; for a label most of whose
        trajectories are younger, the newest and the third or second.
    labels : (n,) int64
        Of the newest.
    objects : collection of int
        Labels that are known to move by themselves: the matrix is not fitted to them.
    speeds : mapping of int to float
        Label → its speed against the homography, × the least one of an object.
    fixed : (h, w) bool
        Cells that are fixed in the picture: the scene ends at a bonnet as at the frame's border.
    shape : (int, int)
        (H, W) of the frame.

    Returns
    -------
    SceneEvidence
        Of all labels but the background.
    """
    scene = scene_squares(fixed, shape)
    judged = sorted(distinct_labels(labels) - {BACKGROUND, UNLABELLED})
    standing = {
        label: _standing(labels == label, places[0].positions, speeds[label], scene, shape)
        for label in judged
    }
    motion, priors = dict[int, float](), dict.fromkeys(judged, UNKNOWN_PRIOR)
    least = {label: max(config.min_tracks, np.count_nonzero(labels == label) / 2) for label in judged}
    oldest = len(places) - 1
    for frames in (one for one in (oldest, 2, 1) if 0 < one <= oldest):
        if len(motion) == len(judged):
            break
        pairs = _Pairs.between(places[frames], places[0], labels, shape)
        known = [one for one in judged if one not in motion and pairs.count(one) >= least[one]]
        if not known:
            continue
        points = pairs.spread(distinct_labels(pairs.labels) - set(objects), SPACING_PX)
        fit = _Fit.to(pairs, points)
        if fit is not None and frames == oldest and fit.holds(points, config):
            priors = dict.fromkeys(judged, fit.prior(points))
        motion |= dict.fromkeys(known, 0.0)
        for label in known:
            others = points[pairs.labels[points] != label]
            odds = None if fit is None else _motion_odds(fit, pairs, label, others, points, config)
            if odds is not None and fit is not None:
                motion[label] = odds
                if frames == oldest:
                    priors[label] = fit.prior(others)
    return SceneEvidence(motion, {label: standing[label] + priors[label] for label in judged})


def _standing(own: Array, positions: Array, speed: float, scene: Array, shape: tuple[int, int]) -> float:
    """Return the log-likelihood ratio by the border, area and speed of a label's trajectories, (n,) bool."""
    taken = taken_squares(positions[own], shape)
    border, area = border_share(taken, scene), float(taken.mean())
    large = _curve(area, AREA) * _curve(border, AREA_BORDER)
    reaching = _curve(border, BORDER if area > SMALL else SMALL_BORDER)
    return reaching + large + _curve(math.log2(max(speed, 1e-3)), SPEED)


def _motion_odds(
    fit: _Fit, pairs: _Pairs, label: int, others: Array, points: Array, config: LayersConfig
) -> float | None:
    """Return the log-likelihood ratio of a label's motion; None if no matrix holds for the others (k,)."""
    if len(others) > (1 - LARGE) * len(points):
        return fit.odds(pairs, label, others, LOWEST, HIGHEST, config)
    odds = fit.odds(pairs, label, others, LARGE_LOWEST, LARGE_HIGHEST, config)
    theirs = _Fit.to(pairs, others)
    alone = None if theirs is None else theirs.odds(pairs, label, others, LOWEST, HIGHEST, config)
    if theirs is None or alone is None or odds is None:
        return odds if alone is None else alone
    weight = _curve(theirs.depth(others), OTHERS_WEIGHT)
    return weight * alone + (1 - weight) * odds


@dataclass(frozen=True, slots=True)
class _Fit:
    """What one rigid scene and one plane, fitted to some trajectories, explain of all.

    Attributes
    ----------
    explained : (m,) float64
        The share of the matrices, one of each part of the points, that explain a trajectory.
    obeying : (m,) float64
        The share of those by which it is static.
    flat : (m,) bool
        Whether the homography explains it.
    """

    explained: Array
    obeying: Array
    flat: Array

    @classmethod
    def to(cls, pairs: _Pairs, points: Array) -> _Fit | None:
        """Fit to trajectories (k,); None if they are too few or too irregular."""
        if len(points) < LEAST_POINTS:
            return None
        flat = _on_plane(pairs, points)
        scenes = [_in_scene(pairs, points[first::PARTS]) for first in range(PARTS)]
        found = [one for one in scenes if one is not None]
        if flat is None or len(found) < len(scenes):
            return None
        explained, static = (np.mean(one, axis=0) for one in zip(*found, strict=True))
        return cls(explained, static, flat)

    def holds(self, points: Array, config: LayersConfig) -> bool:
        """Whether the matrix explains trajectories (k,) as a whole."""
        return bool(self.explained[points].mean() >= config.scene_obeying)

    def depth(self, points: Array) -> float:
        """Return by how much more of trajectories (k,) the matrix explains than the homography."""
        return float(self.explained[points].mean() - self.flat[points].mean())

    def prior(self, points: Array) -> float:
        """Return the log-odds that a label beside trajectories (k,) is static."""
        return _curve(float(self.flat[points].mean()), PRIOR)

    def odds(
        self, pairs: _Pairs, label: int, others: Array, lowest: _Curve, highest: _Curve, config: LayersConfig
    ) -> float | None:
        """Return the log-likelihood ratio of a label's motion; None if the matrix fails for the others."""
        if len(others) < LEAST_POINTS or not self.holds(others, config):
            return None
        share = _curve(float(self.obeying[pairs.labels == label].mean()), OBEYING)
        return abs(share) * _curve(self.depth(others), highest if share > 0 else lowest)


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


def _in_scene(pairs: _Pairs, chosen: Array) -> tuple[Array, Array] | None:
    """Tell which trajectories are parts of the rigid scene of some of them.

    Parameters
    ----------
    pairs : _Pairs
    chosen : (k,) intp

    Returns
    -------
    explained : (m,) bool
        Whether they obey the essential matrix. None in place of both if there is none.
    static : (m,) bool
        Whether they do so closely, and in front of the camera.
    """
    ends, starts = pairs.now[chosen], pairs.before[chosen]
    try:
        essential, inliers = cv2.findEssentialMat(
            ends, starts, pairs.camera, cv2.USAC_MAGSAC, CONFIDENCE, INLIER_PX * pairs.scale, MOST_SAMPLES
        )
    except cv2.error:  # with points in random motion OpenCV may find no matrix, and fail on that
        return None
    if essential is None or essential.shape != (3, 3) or not inliers.any():
        return None
    some = np.flatnonzero(inliers)
    some = some[:: 1 + len(some) // SIDE_POINTS]
    _, rotation, translation, _ = cv2.recoverPose(essential, ends[some], starts[some], pairs.camera)
    # Where points at infinity would have come from, and which way nearer ones did.
    turned = pairs.camera @ rotation @ np.linalg.inv(pairs.camera)
    farthest = cv2.perspectiveTransform(pairs.now[None], turned)[0]
    epipole = (pairs.camera @ translation).ravel()
    towards = epipole[:2] - epipole[2] * farthest
    towards /= np.maximum(np.hypot(*towards.T), 1e-9)[:, None]
    parallax = pairs.before - farthest
    length = np.hypot(*parallax.T)
    off = np.abs(parallax[:, 0] * towards[:, 1] - parallax[:, 1] * towards[:, 0]) - INLIER_PX * pairs.scale
    static = off < INLIER_RELATIVE * np.minimum(length, MOST_PARALLAX_PX * pairs.scale)
    static &= (parallax * towards).sum(axis=1) > -BEHIND_PX * pairs.scale
    return np.asarray(off < INLIER_RELATIVE * length), static


def _on_plane(pairs: _Pairs, chosen: Array) -> Array | None:
    """Tell which trajectories (m,) bool the homography of some of them (k,) explains.

    By MAGSAC, like the essential matrix, but with OpenCV's own limits. Plain RANSAC stops at the first
    homography that is good enough: of planes that one homography explains to 92 to 100 %, it explained 73 to
    95 %, so that they were taken to have depth.
    """
    ends, starts = pairs.now[chosen], pairs.before[chosen]
    matrix, _ = cv2.findHomography(ends, starts, cv2.USAC_MAGSAC, PLANE_PX * pairs.scale)
    if matrix is None:
        return None
    error = cv2.perspectiveTransform(pairs.now[None], matrix)[0] - pairs.before
    return np.asarray(np.hypot(*error.T) < PLANE_PX * pairs.scale)


def _curve(place: float, curve: _Curve) -> float:
    """Return the value of a curve at a place."""
    return float(np.interp(place, *curve))
