"""Where the scene is in each picture, for the zones that are fixed to it.

The engine gives the camera's motion from picture to picture. Chained, it leads from the first picture to
every other one, but it drifts, and ends at a cut. So once a second the picture is compared with *views*
(:mod:`orchestrator.events.views`): pictures whose place in the scene is known, the first of which is the
stream's first picture. A camera that returns to a view is found again there.

What is found depends on the frames alone. A tracker that is opened again needs the place after the last row
that counts, and the views up to then, which are files.
"""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.messages import NO_PICTURE, Array, Segmentation
from mlbs_actors.record.scene_place import ScenePlace
from orchestrator.events.views import View, picture_for_views

__all__ = ["VIEWS", "SceneTracker", "resizing"]

#: Folder of the views, in the stream's.
VIEWS = ".views"

#: Most views of a scene.
_MOST_VIEWS = 12

#: Least share of a picture that a view must show to be compared with it, and below which it gets a view of
#: its own.
_LEAST_SHARED, _MOST_OWN = 0.4, 0.6

#: Where a view puts the picture farther from where the chain does, neither is trusted; a share of its width.
_MOST_ASTRAY = 0.1

#: Points on each side of the grid by which shares of a picture are measured.
_GRID = 9


class SceneTracker:
    """Follows the scene through the pictures of a stream.

    Parameters
    ----------
    folder : Path, optional
        Of the views; by default there are none yet.
    rows : int
        Rows of the record that count: later views are forgotten.
    place : ScenePlace, optional
        In the last of these rows that has a label map.
    pts : float
        Time of that, s.

    Attributes
    ----------
    place : ScenePlace or None
        None while it is unknown.
    """

    def __init__(self, folder: Path | None, rows: int, place: ScenePlace | None, pts: float) -> None:
        self.place = place
        self._pts = pts
        self._views: list[View] = []
        for path in () if folder is None else sorted(folder.glob("*.npz")):
            if int(path.stem) < rows:
                self._views.append(View.read(path))
            else:
                path.unlink()

    def after(self, pts: float, segmentation: Segmentation, image: Array) -> View | None:
        """Follow the scene into the next picture; return it if it becomes a view.

        Parameters
        ----------
        pts : float
            s.
        segmentation : Segmentation
        image : (H, W, 3) uint8
        """
        due = math.floor(pts) != math.floor(self._pts) or segmentation.status == "cut"
        was_known, self._pts = self.place is not None, pts
        if segmentation.status in NO_PICTURE:
            return None
        camera = segmentation.camera
        if self.place is not None:
            chained = None if camera is None else np.linalg.solve(camera, self.place.array)
            self.place = None if chained is None else ScenePlace.of(self.place.shape, chained)
        if not self._views:
            self.place = ScenePlace.of(_shape(image), np.eye(3))
        elif due or (was_known and self.place is None):
            return self._compare(image, segmentation.labels)
        else:
            return None
        return self._add(View.of(image, self.place.array))

    def _compare(self, image: Array, labels: Array) -> View | None:
        """Correct the place by the views; return the picture if none of them shows enough of it."""
        views = self._views
        if self.place is not None:
            shared = [_share(view, self.place, _shape(image)) for view in views]
            best = int(np.argmax(shared))
            views, most = [views[best]] if shared[best] >= _LEAST_SHARED else [], shared[best]
        picture = picture_for_views(image, labels)
        found = [one for view in views if (one := view.find(picture)) is not None]
        if found:
            match = max(found, key=lambda one: one.points)  # of equals the first
            there = ScenePlace.of(self._views[0].shape, match.matrix)
            if self.place is not None and _astray(self.place, there, _shape(image)) > _MOST_ASTRAY:
                self.place = None
                return None
            if self.place is None:
                self.place = there
                return None
            self.place = there
        if self.place is None or most >= _MOST_OWN or len(self._views) >= _MOST_VIEWS:
            return None
        return self._add(View.of(image, self.place.array))

    def _add(self, view: View) -> View:
        self._views.append(view)
        return view


def resizing(small: tuple[int, ...], large: tuple[int, ...]) -> Array:
    """Return the homography (3, 3) from a picture of one shape (H, W) to the same in another one."""
    matrix = np.eye(3)
    for axis, (before, after) in enumerate(zip(small[1::-1], large[1::-1], strict=True)):
        scale = after / before
        matrix[axis, axis], matrix[axis, 2] = scale, (scale - 1) / 2  # pixels' centres are whole numbers
    return matrix


def _shape(image: Array) -> tuple[int, int]:
    return int(image.shape[0]), int(image.shape[1])


def _share(view: View, place: ScenePlace, shape: tuple[int, int]) -> float:
    """Return the share of a picture that a view shows."""
    x, y = np.meshgrid(np.linspace(0, shape[1] - 1, _GRID), np.linspace(0, shape[0] - 1, _GRID))
    across, down, depth = view.matrix @ np.linalg.solve(
        place.array, np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    )
    inside = (depth > 0) & (across >= 0) & (across < depth * view.shape[1])
    return float((inside & (down >= 0) & (down < depth * view.shape[0])).mean())


def _astray(one: ScenePlace, other: ScenePlace, shape: tuple[int, int]) -> float:
    """Return how far apart two places put the corners of a picture at most, as a share of its width."""
    height, width = shape
    corners = np.array([[[0, 0], [width, 0], [0, height], [width, height]]], np.float64)
    apart = cv2.perspectiveTransform(corners, other.array @ np.linalg.inv(one.array)) - corners
    return float(np.hypot(*apart[0].T).max()) / width
