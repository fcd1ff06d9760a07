"""Where the scene is in a picture: how zones that are fixed to it are found there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mlbs_actors.messages import Array

__all__ = ["Point", "ScenePlace"]

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ScenePlace:
    """Where the scene is in a picture.

    Attributes
    ----------
    shape : (H, W)
        Of the stream's first picture, in which zones are drawn.
    matrix : tuple of float
        Homography, row by row, that takes its pixels to where they are in this picture.
    """

    shape: tuple[int, int]
    matrix: tuple[float, ...]

    @classmethod
    def of(cls, shape: tuple[int, int], matrix: Array) -> ScenePlace:
        """Make a place of a (3, 3) homography of any scale."""
        # With a determinant of 1 a point in front of the camera has a positive depth.
        return cls(shape, tuple((matrix / np.cbrt(np.linalg.det(matrix))).ravel().tolist()))

    @property
    def array(self) -> Array:
        """The homography, (3, 3) float64."""
        return np.array(self.matrix).reshape(3, 3)

    def back(self, point: Point) -> Point | None:
        """Return where a point of this picture is in the first one, px; None if it cannot be seen from there.

        Pixels are squares here: the first one's centre is at (½, ½).
        """
        x, y, depth = np.linalg.solve(self.array, [point[0] - 0.5, point[1] - 0.5, 1.0]).tolist()
        return None if depth <= 0 else (x / depth + 0.5, y / depth + 0.5)

    def forth(self, points: Array) -> Array:
        """Return where points (n, 2) of the first picture are in this one, px, without those behind it."""
        x, y, depth = self.array @ np.column_stack([points - 0.5, np.ones(len(points))]).T
        seen = depth > 1e-6
        return np.column_stack([x[seen] / depth[seen], y[seen] / depth[seen]]) + 0.5
