"""The planes on which the points of a scene lie, in the picture of one of its frames."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from mlbs_actors.messages import Array

__all__ = ["LEAST_POINTS", "depth_at", "planes_of"]

#: Planes looked for, at most, and points that one must have.
PLANES, LEAST_POINTS = 12, 12
#: Triples of points that are tried for a plane; half of them are points this near to each other, in number.
TRIED, NEIGHBOURS = 400, 30
#: Tolerances from a plane at which a point has no say in it, and up to which none of the planes after it is
#: found by it.
OFF, TAKEN = 2.0, 6.0


def depth_at(planes: Array, points: Array) -> Array:
    """Return the inverse depths of planes (…, 3) at pixels (…, 2)."""
    return np.asarray(points[..., 0] * planes[..., 0] + points[..., 1] * planes[..., 1] + planes[..., 2])


def planes_of(at: Array, inverse: Array, tolerance: Array) -> Array:
    """Find the planes on which points lie, one after the other, each by the points that those before leave.

    Parameters
    ----------
    at : (n, 2) float64
        In the picture; at least :data:`LEAST_POINTS`.
    inverse : (n,) float64
        Their inverse depths.
    tolerance : (n,) float64
        By how much each may miss its plane, inverse depth.

    Returns
    -------
    (k, 3) float64
        A plane's inverse depth at a pixel is (x, y, 1) times it; at least one, that with most points first.
    """
    rng = np.random.default_rng(1)
    found: list[Array] = []
    while len(found) < PLANES and len(at) >= LEAST_POINTS:
        plane = _plane(at, inverse, tolerance, rng)
        missed = np.abs(depth_at(plane, at) - inverse) / tolerance
        if found and (missed < OFF).sum() < LEAST_POINTS:
            break
        off = missed > TAKEN
        found.append(plane)
        at, inverse, tolerance = at[off], inverse[off], tolerance[off]
    return np.array(found)


def _plane(at: Array, inverse: Array, tolerance: Array, rng: np.random.Generator) -> Array:
    rows = np.column_stack([at, np.ones(len(at))])
    corners = rng.integers(0, len(at), (TRIED, 3))
    some = corners[: TRIED // 2]
    near = np.asarray(cKDTree(at).query(at[some[:, 0]], min(NEIGHBOURS, len(at)))[1])
    some[:, 1:] = np.take_along_axis(near, some[:, 1:] % near.shape[1], axis=1)
    usable = np.abs(np.linalg.det(rows[corners])) > 1.0
    tried = np.linalg.solve(rows[corners[usable]], inverse[corners[usable]][..., None])[..., 0]
    tried = np.vstack([tried, [0.0, 0.0, np.median(inverse)]])
    rows, inverse = rows / tolerance[:, None], inverse / tolerance
    off = tried @ rows.T - inverse
    plane = tried[np.argmax(np.maximum(0, 1 - (off / OFF) ** 2).sum(axis=1))]
    for _ in range(5):
        share = np.maximum(0, 1 - ((rows @ plane - inverse) / OFF) ** 2)
        if (share > 0).sum() < LEAST_POINTS:
            break
        plane = np.linalg.lstsq(rows * share[:, None], inverse * share, rcond=None)[0]
    return np.asarray(plane)
