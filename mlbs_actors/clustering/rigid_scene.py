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

What motion tells is gathered over the lives of the trajectories, not of the labels: a piece of the scene that
is cut off the background at one clustering, and joins it again, is another label at the next.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mlbs_actors.clustering.label_index import UNLABELLED, distinct_labels
from mlbs_actors.clustering.outline import border_share, scene_squares, taken_squares
from mlbs_actors.clustering.two_views import FocalLength, Pairs, Places, in_scene, on_plane
from mlbs_actors.config import IdentityConfig, LayersConfig
from mlbs_actors.messages import BACKGROUND, Array

__all__ = ["SceneEvidence", "scene_evidence"]

#: Places, ascending, and values of a curve that is linear in between.
_Curve = tuple[tuple[float, ...], tuple[float, ...]]

#: Fewest points to which matrices are fitted, into how many parts they are divided, and their spacing, px.
LEAST_POINTS, PARTS, SPACING_PX = 20, 4, 20.0
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
class SceneEvidence:
    """How likely labels are static, in nats: positive for a part of the scene.

    Attributes
    ----------
    motion : dict of int to float
        Label → log-likelihood ratio of its motion in the last pictures; without those of which nothing is
        known. It is worth gathering: every clustering sees other pictures.
    standing : dict of int to float
        Label → log-odds by all else, which changes little from one clustering to the next.
    focal_length : FocalLength
        As rated by the last pictures, too.
    """

    motion: dict[int, float]
    standing: dict[int, float]
    focal_length: FocalLength

    def gathered(self, static: Array, labels: Array, config: IdentityConfig) -> Array:
        """Add the evidence of motion to what is known of each trajectory.

        Parameters
        ----------
        static : (n,) float32
            Log-odds by motion that each is static, nats; NaN where nothing is known.
        labels : (n,) int64
        config : IdentityConfig

        Returns
        -------
        (n,) float32
        """
        static = static.copy()
        for label, odds in self.motion.items():
            own = labels == label
            before = static[own]
            known = np.isfinite(before)
            if known.any():
                before[~known] = before[known].mean()
                static[own] = config.fading * before + config.weight * odds
            else:  # a label of which nothing is known is decided on at once, by all that there is
                static[own] = odds
        return static

    def odds(self, static: Array, labels: Array) -> dict[int, float]:
        """Return the log-odds that each label is static, by all that is known.

        Parameters
        ----------
        static : (n,) float32
            From :meth:`gathered`.
        labels : (n,) int64
        """
        odds = {}
        for label, standing in self.standing.items():
            known = static[(labels == label) & np.isfinite(static)]
            odds[label] = standing + (float(known.mean()) if known.size else 0.0)
        return odds


def scene_evidence(
    places: Sequence[Places],
    labels: Array,
    objects: Collection[int],
    speeds: Mapping[int, float],
    fixed: Array,
    shape: tuple[int, int],
    focal_length: FocalLength,
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
        Labels that have been taken for objects: the matrices are not fitted to them.
    speeds : mapping of int to float
        Label → its speed against the homography, × the least one of an object.
    fixed : (h, w) bool
        Cells that are fixed in the picture: the scene ends at a bonnet as at the frame's border.
    shape : (int, int)
        (H, W) of the frame.
    focal_length : FocalLength
        As rated so far.
    config : LayersConfig

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
        pairs = Pairs.between(places[frames], places[0], labels, shape)
        known = [one for one in judged if one not in motion and pairs.count(one) >= least[one]]
        if not known:
            continue
        points = pairs.spread(distinct_labels(pairs.labels) - set(objects), SPACING_PX)
        if frames == oldest and len(points) >= LEAST_POINTS:
            focal_length = focal_length.rated(pairs, points, points[::PARTS])
        pairs = replace(pairs, focal_length=focal_length.best)
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
    standing = {label: standing[label] + priors[label] for label in judged}
    return SceneEvidence(motion, standing, focal_length)


def _standing(own: Array, positions: Array, speed: float, scene: Array, shape: tuple[int, int]) -> float:
    """Return the log-likelihood ratio by the border, area and speed of a label's trajectories, (n,) bool."""
    taken = taken_squares(positions[own], shape)
    border, area = border_share(taken, scene), float(taken.mean())
    large = _curve(area, AREA) * _curve(border, AREA_BORDER)
    reaching = _curve(border, BORDER if area > SMALL else SMALL_BORDER)
    return reaching + large + _curve(math.log2(max(speed, 1e-3)), SPEED)


def _motion_odds(
    fit: _Fit, pairs: Pairs, label: int, others: Array, points: Array, config: LayersConfig
) -> float | None:
    """Return the log-likelihood ratio of a label's motion; None if no matrix holds for the others (k,)."""
    if len(others) > (1 - LARGE) * len(points):
        return fit.odds(pairs, label, others, LOWEST, HIGHEST, config)
    odds = fit.odds(pairs, label, others, LARGE_LOWEST, LARGE_HIGHEST, config)
    weight = 0.0 if odds is None else _curve(fit.depth(others), OTHERS_WEIGHT)
    theirs = _Fit.to(pairs, others) if weight > 0 else None
    alone = None if theirs is None else theirs.odds(pairs, label, others, LOWEST, HIGHEST, config)
    return odds if odds is None or alone is None else weight * alone + (1 - weight) * odds


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
    def to(cls, pairs: Pairs, points: Array) -> _Fit | None:
        """Fit to trajectories (k,); None if they are too few or too irregular."""
        if len(points) < LEAST_POINTS:
            return None
        flat = on_plane(pairs, points)
        scenes = [in_scene(pairs, points[first::PARTS]) for first in range(PARTS)]
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
        self, pairs: Pairs, label: int, others: Array, lowest: _Curve, highest: _Curve, config: LayersConfig
    ) -> float | None:
        """Return the log-likelihood ratio of a label's motion; None if the matrix fails for the others."""
        if len(others) < LEAST_POINTS or not self.holds(others, config):
            return None
        share = _curve(float(self.obeying[pairs.labels == label].mean()), OBEYING)
        return abs(share) * _curve(self.depth(others), highest if share > 0 else lowest)


def _curve(place: float, curve: _Curve) -> float:
    """Return the value of a curve at a place."""
    return float(np.interp(place, *curve))
