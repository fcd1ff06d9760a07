"""Two pictures of one rigid scene: which trajectories an essential matrix explains, and which a homography.

Not in the paper, which has no camera model. The matrix wants the focal length, which no video tells.
:class:`FocalLength` estimates it from what the matrices explain: with a wrong one a scene of two planes, such
as a slope before a far meadow, is no rigid scene. (A fundamental matrix wants none, but bends to what moves.)
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import cv2
import numpy as np

from mlbs_actors.config import length_scale
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array
from mlbs_actors.tracking.rolling_shutter import Swing
from mlbs_actors.tracking.trajectories import evenly_spread

__all__ = ["FocalLength", "Pairs", "Places", "in_scene", "on_plane"]

#: Confidence that the best matrix was found, and most samples drawn for it.
CONFIDENCE, MOST_SAMPLES = 0.999, 1000
#: Distance to the epipolar line of a point that obeys, px, and what is added to it, × its parallax; to be
#: static, no more than that of so much parallax, px.
INLIER_PX, INLIER_RELATIVE, MOST_PARALLAX_PX = 1.0, 0.02, 50.0
#: Distance within which a homography explains a point, px: errors along the line count as well.
PLANE_PX = 1.5
#: What is static has at most so many px of parallax towards the wrong side.
BEHIND_PX = 2.0
#: So many points tell on which side of the camera they are.
SIDE_POINTS = 50
#: Focal lengths to choose from, × the longer side of the frame, and the usual one; what another must explain
#: more.
FOCAL_LENGTHS, USUAL, LEAST_MORE = (0.7, 1.1, 2.0, 4.0), 1.1, 0.05
#: Weight of the last pictures.
NEWEST = 0.2
#: So many clusterings rate the focal lengths, and then one in so many: zooming is slow, and rating takes as
#: long as all matrices that are wanted.
FIRST_RATINGS, RATING_PERIOD = 10, 4


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

    def without(self, swing: Swing) -> Places:
        """Return where they would have been had the rows not swung since; on the way rows hardly change."""
        return replace(self, positions=self.positions - swing.at(self.positions[:, 1]))


@dataclass(frozen=True, slots=True)
class FocalLength:
    """How well each focal length has explained the scene.

    Attributes
    ----------
    shares : tuple of float
        For each of ``FOCAL_LENGTHS``, the share of the trajectories that it explained, averaged over time.
    clusterings : int
        How many there have been that could rate it.
    """

    shares: tuple[float, ...] = (0.0,) * len(FOCAL_LENGTHS)
    clusterings: int = 0

    @property
    def best(self) -> float:
        """The likeliest one, × the longer side of the frame."""
        usual = self.shares[FOCAL_LENGTHS.index(USUAL)]
        best = int(np.argmax(self.shares))
        return FOCAL_LENGTHS[best] if self.shares[best] > usual + LEAST_MORE else USUAL

    def rated(self, pairs: Pairs, points: Array, fitted: Array) -> FocalLength:
        """Add what the last pictures tell, if they are to be rated.

        Parameters
        ----------
        pairs : Pairs
        points : (k,) intp
            Trajectories that may be static.
        fitted : (j,) intp
            Those of them to which the matrices are fitted.
        """
        clusterings = self.clusterings + 1
        if clusterings > FIRST_RATINGS and clusterings % RATING_PERIOD:
            return replace(self, clusterings=clusterings)
        shares = []
        for length, before in zip(FOCAL_LENGTHS, self.shares, strict=True):
            found = in_scene(replace(pairs, focal_length=length), fitted)
            share = 0.0 if found is None else float(found[1][points].mean())
            shares.append((1 - NEWEST) * before + NEWEST * share)
        return FocalLength(tuple(shares), clusterings)


@dataclass(frozen=True, slots=True)
class Pairs:
    """The trajectories that are in two pictures.

    Attributes
    ----------
    now, before : (m, 2) float64
        Their places, px.
    labels : (m,) int64
    shape : (int, int)
        (H, W) of the frame.
    focal_length : float
        × its longer side.
    """

    now: Array
    before: Array
    labels: Array
    shape: tuple[int, int]
    focal_length: float = USUAL

    @classmethod
    def between(cls, before: Places, now: Places, labels: Array, shape: tuple[int, int]) -> Pairs:
        """Pair the trajectories of the newer picture, of these labels (n,) int64, with those of the older."""
        _, at, there = np.intersect1d(now.ids, before.ids, assume_unique=True, return_indices=True)
        ends, starts = now.positions[at].astype(np.float64), before.positions[there].astype(np.float64)
        return cls(ends, starts, labels[at], shape)

    @property
    def camera(self) -> Array:
        """(3, 3) float64 that takes directions to px."""
        focal = self.focal_length * max(self.shape)
        return np.array([[focal, 0, self.shape[1] / 2], [0, focal, self.shape[0] / 2], [0, 0, 1]])

    @property
    def scale(self) -> float:
        """:func:`~mlbs_actors.config.length_scale` of the frame."""
        return length_scale(*self.shape)

    def count(self, label: int) -> int:
        """Return how many trajectories a label has."""
        return int((self.labels == label).sum())

    def spread(self, labels: Collection[int], spacing: float) -> Array:
        """Return indices (k,) of trajectories of some labels, at most one a square."""
        chosen = np.isin(self.labels, list(labels))
        return evenly_spread(self.now.astype(np.float32), chosen, spacing * self.scale)


def in_scene(pairs: Pairs, chosen: Array) -> tuple[Array, Array] | None:
    """Tell which trajectories are parts of the rigid scene of some of them.

    Parameters
    ----------
    pairs : Pairs
    chosen : (k,) intp

    Returns
    -------
    explained : (m,) bool
        Whether they obey the essential matrix. None in place of both if there is none.
    static : (m,) bool
        Whether they do so closely, and in front of the camera.
    """
    ends, starts, camera = pairs.now[chosen], pairs.before[chosen], pairs.camera
    try:
        essential, inliers = cv2.findEssentialMat(
            ends, starts, camera, cv2.USAC_MAGSAC, CONFIDENCE, INLIER_PX * pairs.scale, MOST_SAMPLES
        )
    except cv2.error:  # with points in random motion OpenCV may find no matrix, and fail on that
        return None
    if essential is None or essential.shape != (3, 3) or not inliers.any():
        return None
    some = np.flatnonzero(inliers)
    some = some[:: 1 + len(some) // SIDE_POINTS]
    _, rotation, translation, _ = cv2.recoverPose(essential, ends[some], starts[some], camera)
    turned, epipole = camera @ rotation @ np.linalg.inv(camera), (camera @ translation).ravel()
    explained, static = _obeying(pairs.now, pairs.before, turned, epipole, pairs.scale)
    return explained, static


@compiled
def _obeying(now: Array, before: Array, turned: Array, epipole: Array, scale: float) -> tuple[Array, Array]:
    """Compute :func:`in_scene` for a camera that has turned, (3, 3) px to px, and moved away from a point."""
    explained, static = np.empty(len(now), np.bool_), np.empty(len(now), np.bool_)
    for point in range(len(now)):
        x, y = now[point]
        # Where a point at infinity would have come from, and which way a nearer one did.
        depth = turned[2, 0] * x + turned[2, 1] * y + turned[2, 2]
        far_x = (turned[0, 0] * x + turned[0, 1] * y + turned[0, 2]) / depth
        far_y = (turned[1, 0] * x + turned[1, 1] * y + turned[1, 2]) / depth
        towards_x, towards_y = epipole[0] - epipole[2] * far_x, epipole[1] - epipole[2] * far_y
        length = max(np.hypot(towards_x, towards_y), 1e-9)
        towards_x, towards_y = towards_x / length, towards_y / length
        parallax_x, parallax_y = before[point, 0] - far_x, before[point, 1] - far_y
        parallax = np.hypot(parallax_x, parallax_y)
        off = abs(parallax_x * towards_y - parallax_y * towards_x) - INLIER_PX * scale
        forward = parallax_x * towards_x + parallax_y * towards_y > -BEHIND_PX * scale
        explained[point] = off < INLIER_RELATIVE * parallax
        static[point] = forward and off < INLIER_RELATIVE * min(parallax, MOST_PARALLAX_PX * scale)
    return explained, static


def on_plane(pairs: Pairs, chosen: Array) -> Array | None:
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
