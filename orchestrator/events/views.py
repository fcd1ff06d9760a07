"""Views: small pictures whose place in the scene is known, in which later pictures are found again.

Corners of both are matched by their SIFT descriptors, and a homography is fitted to the matches by RANSAC
(seeded inside OpenCV).
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.messages import BACKGROUND, Array

__all__ = ["Found", "SmallPicture", "View", "picture_for_views"]

#: Longer side of the small pictures, px.
_SIDE = 480

_FEATURES = 600

#: A match must be better than the second best by this factor.
_DISTINCT = 0.75

#: Largest error of a match, px of the small pictures; least matches that agree, and share of all.
_INLIER_PX, _LEAST_POINTS, _LEAST_SHARE = 2.0, 20, 0.3

#: Largest factor by which a view may be enlarged.
_MOST_ZOOM = 3.0


@dataclass(frozen=True)
class SmallPicture:
    """A picture as it is compared with others.

    Attributes
    ----------
    gray : (h, w) uint8
    shape : (H, W)
        Of the full picture.
    seen : (h, w) uint8, optional
        0 where objects hide the scene; None if that is not known.
    """

    gray: Array
    shape: tuple[int, int]
    seen: Array | None = None

    @cached_property
    def features(self) -> tuple[Array, Array]:
        """Places (n, 2) float64, px of the full picture, and descriptors (n, 128) float32 of its corners."""
        points, descriptors = cv2.SIFT.create(_FEATURES).detectAndCompute(self.gray, self.seen)
        if descriptors is None:
            return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
        places = np.array([point.pt for point in points], np.float64)
        return (places + 0.5) * self.px - 0.5, np.asarray(descriptors, np.float32)

    @property
    def px(self) -> Array:
        """Width and height of its pixels, px of the full picture."""
        return np.asarray(np.array(self.shape[::-1]) / np.array(self.gray.shape[::-1]))


@dataclass(frozen=True)
class Found:
    """Where a view was found.

    Attributes
    ----------
    matrix : (3, 3) float64
        Takes pixels of the first picture of the stream to the one in which the view was found.
    points : int
        Matches that say so.
    """

    matrix: Array
    points: int


@dataclass(frozen=True)
class View:
    """A picture of the scene.

    Attributes
    ----------
    picture : SmallPicture
    matrix : (3, 3) float64
        Takes pixels of the first picture of the stream to this one.
    """

    picture: SmallPicture
    matrix: Array

    @classmethod
    def of(cls, image: Array, matrix: Array) -> View:
        """Make a view of an image (H, W, 3) uint8."""
        return cls(picture_for_views(image), matrix)

    @classmethod
    def read(cls, path: Path) -> View:
        """Read what :meth:`content` has written."""
        with np.load(path) as arrays:
            shape = arrays["shape"].tolist()
            return cls(SmallPicture(arrays["gray"], (shape[0], shape[1])), arrays["matrix"])

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the full picture."""
        return self.picture.shape

    def content(self) -> bytes:
        """Return the content of its file."""
        file = io.BytesIO()
        np.savez_compressed(file, gray=self.picture.gray, shape=self.shape, matrix=self.matrix)
        return file.getvalue()

    def find(self, picture: SmallPicture) -> Found | None:
        """Find the view in a picture, None if it is not there."""
        (here, own), (there, other) = self.picture.features, picture.features
        if min(len(here), len(there)) < _LEAST_POINTS:
            return None
        pairs = cv2.BFMatcher().knnMatch(own, other, k=2)
        close = [best for best, second in pairs if best.distance < _DISTINCT * second.distance]
        if len(close) < _LEAST_POINTS:
            return None
        begin, end = here[[one.queryIdx for one in close]], there[[one.trainIdx for one in close]]
        matrix, agree = cv2.findHomography(begin, end, cv2.RANSAC, _INLIER_PX * float(picture.px.max()))
        if matrix is None or agree.sum() < max(_LEAST_POINTS, _LEAST_SHARE * len(close)):
            return None
        zoom = abs(np.linalg.det(matrix[:2, :2])) ** 0.5
        if not 1 / _MOST_ZOOM < zoom < _MOST_ZOOM:
            return None
        return Found(matrix @ self.matrix, int(agree.sum()))


def picture_for_views(image: Array, labels: Array | None = None) -> SmallPicture:
    """Shrink an image (H, W, 3) uint8, and its label map (H, W) if given."""
    height, width = image.shape[:2]
    share = min(1.0, _SIDE / max(height, width))
    size = (max(1, round(width * share)), max(1, round(height * share)))
    gray = cv2.cvtColor(cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
    seen = None
    if labels is not None:
        small = cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST)
        seen = np.where(small == BACKGROUND, np.uint8(255), np.uint8(0))
    return SmallPicture(np.asarray(gray), (height, width), seen)
