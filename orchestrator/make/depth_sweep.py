"""How far away the background behind a hole is: where the sources agree on what they see there.

Planes are tried one after the other, all of them parallel to the one on which most of the points around lie.
Each source is laid onto a plane; where the plane is the background, the sources show the same, whether or not
the frame itself shows it. A pixel takes the plane on which they agree, on which its neighbours lie, and near
which points are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from mlbs_actors.messages import Array
from orchestrator.make.background_motion import CELL
from orchestrator.make.holes import Hole
from orchestrator.make.scene_geometry import Relation
from orchestrator.make.source_frames import Source

__all__ = ["plane_of", "swept"]

#: Pixels of a sketch in each direction for one whose depth is looked for.
STRIDE = 2
#: Planes tried, least and most, and by how much one displaces the background against the next, px.
PLANES, STEP_PX = (8, 64), 1.0
#: A greater difference of two sources counts as this one, grey levels.
DIFFERENT = 40
#: How much more the frame itself has to say than a source.
OWN = 4
#: Side of the square over which differences are averaged, px of STRIDE.
PATCH = 3
#: What is taken for the difference where no two sources show a plane, grey levels.
UNKNOWN = 12.0
#: What a plane costs at most that is far from all points known, grey levels, and at which share of the votes
#: of the plane with most of them it costs nothing.
FAR, ENOUGH = 8.0, 0.5
#: What the farthest plane costs more than the nearest: what agrees equally well is hidden by what is nearer.
HIDDEN = 1.0
#: How far the say of a point reaches, cells.
REACH = (1.0, 2.5, 6.0)
#: What it costs to lie on the plane next to a neighbour's, and on any other, grey levels.
BEND, JUMP = 2.0, 14.0
#: Least and greatest change of light between two frames that is corrected, and which is none: pictures that
#: are not yet in place differ by as much.
GAIN, SAME_LIGHT = (0.6, 1.7), 0.07


def plane_of(at: Array, inverse: Array) -> Array:
    """Find the plane on which most points lie.

    Parameters
    ----------
    at : (n, 2) float64
        In the picture; at least three.
    inverse : (n,) float64
        Their inverse depths.

    Returns
    -------
    (3,) float64
        The plane's inverse depth at a pixel is (x, y, 1) times it.
    """
    rows = np.column_stack([at, np.ones(len(at))])
    scale = float(np.ptp(np.quantile(inverse, [0.1, 0.9]))) / 20 + 1e-9
    rng = np.random.default_rng(1)
    corners = rng.integers(0, len(at), (200, 3))
    some = rows[corners]
    usable = np.abs(np.linalg.det(some)) > 1.0
    tried = np.linalg.solve(some[usable], inverse[corners[usable]][..., None])[..., 0]
    tried = np.vstack([tried, [0.0, 0.0, np.median(inverse)]])
    off = (tried @ rows.T - inverse) / scale
    plane = tried[np.argmax((1 / (1 + off**2)).sum(axis=1))]
    for _ in range(5):
        share = 1 / (1 + ((rows @ plane - inverse) / scale) ** 2) ** 2
        plane = np.linalg.lstsq(rows * share[:, None], inverse * share, rcond=None)[0]
    return np.asarray(plane)


@dataclass(frozen=True, slots=True)
class _Planes:
    """Planes parallel to one, ``offsets`` (d,) from it, evenly spaced."""

    plane: Array
    offsets: Array

    def nearest(self, offsets: Array) -> Array:
        step = self.offsets[1] - self.offsets[0]
        nearest = np.round((offsets - self.offsets[0]) / step)
        return np.asarray(nearest.clip(0, len(self.offsets) - 1).astype(int))


def swept(
    hole: Hole, sources: Sequence[Source], relations: Sequence[Relation], at: Array, inverse: Array
) -> Array:
    """Find the inverse depth of a hole's region.

    Parameters
    ----------
    hole : Hole
    sources : sequence of Source
    relations : sequence of Relation
        Of the frame to each source.
    at, inverse : (n, 2), (n,) float64
        Points known: where they lie in the frame's sketch, and their inverse depths.

    Returns
    -------
    (h, w) float32
    """
    region = hole.region
    planes = _planes(hole, relations, at, inverse)
    grid = np.array([[STRIDE, 0, (STRIDE - 1) / 2], [0, STRIDE, (STRIDE - 1) / 2], [0, 0, 1.0]])
    size = (region.width // STRIDE, region.height // STRIDE)
    gray, free = cv2.split(_laid(np.dstack([hole.sketch.gray, hole.sketch.free * np.uint8(255)]), grid, size))
    grid[:2, 2] += (region.x, region.y)
    pictures = [np.dstack([one.sketch.gray, one.sketch.free * np.uint8(255)]) for one in sources]
    own = _shown(gray, free)
    lights = [
        _light(own, _shown(*cv2.split(_laid(picture, relation.of_plane(planes.plane) @ grid, size))))
        for picture, relation in zip(pictures, relations, strict=True)
    ]
    cost = np.empty((size[1], size[0], len(planes.offsets)), np.float32)
    for number, offset in enumerate(planes.offsets):
        shown = [own]
        for picture, relation, light in zip(pictures, relations, lights, strict=True):
            matrix = relation.of_plane(planes.plane + np.array([0, 0, offset])) @ grid
            there, covered = cv2.split(_laid(picture, matrix, size))
            shown.append(_shown(there if light == 1.0 else cv2.convertScaleAbs(there, alpha=light), covered))
        cost[..., number] = _difference(shown)
    cost += _unlikely(hole, planes, at, inverse, size)
    cost += np.linspace(HIDDEN, 0, len(planes.offsets), dtype=np.float32)
    best = _lowest(_smoothed(cost))
    offset = planes.offsets[0] + best * (planes.offsets[1] - planes.offsets[0])
    offset = cv2.resize(
        offset.astype(np.float32), (region.width, region.height), interpolation=cv2.INTER_NEAREST
    )
    return np.asarray(_plane_at(planes.plane, hole.pixels()) + offset, np.float32)


def _plane_at(plane: Array, points: Array) -> Array:
    """Return a plane's inverse depth at pixels (…, 2)."""
    return np.asarray(points[..., 0] * plane[0] + points[..., 1] * plane[1] + plane[2])


def _planes(hole: Hole, relations: Sequence[Relation], at: Array, inverse: Array) -> _Planes:
    """Choose planes between which all points lie, so many that the next one displaces by a pixel."""
    plane = plane_of(at, inverse)
    near, far = np.quantile(inverse - _plane_at(plane, at), [0.01, 0.99])
    more = 0.1 * (far - near) + 1e-9
    near, far = near - more, far + more
    some = hole.pixels()[::16, ::16]
    first, last = (
        [one.places(some, _plane_at(plane, some) + end) for one in relations] for end in (near, far)
    )
    apart = max(np.median(np.linalg.norm(a - b, axis=-1)) for a, b in zip(first, last, strict=True))
    return _Planes(plane, np.linspace(near, far, int(np.clip(np.ceil(apart / STEP_PX) + 1, *PLANES))))


def _laid(picture: Array, matrix: Array, size: tuple[int, int]) -> Array:
    laid: Array = cv2.warpPerspective(picture, matrix, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return laid


def _shown(gray: Array, free: Array) -> tuple[Array, Array]:
    """Return a grey picture (h, w) uint8 and where it shows the background, 0 or 255."""
    return gray, cv2.threshold(free, 250, 255, cv2.THRESH_BINARY)[1]


def _light(one: tuple[Array, Array], other: tuple[Array, Array]) -> float:
    """Return the factor that brings another picture into one's light."""
    both = (one[1] & other[1]) > 0
    if both.sum() < 50:
        return 1.0
    factor = float(np.median(one[0][both]) / max(1.0, float(np.median(other[0][both]))))
    return float(np.clip(factor, *GAIN)) if abs(factor - 1) > SAME_LIGHT else 1.0


def _difference(shown: Sequence[tuple[Array, Array]]) -> Array:
    """Return by how much pictures differ around each pixel, (h, w) float32; the first is the frame's."""
    total = np.zeros(shown[0][0].shape, np.float32)
    for number, (gray, free) in enumerate(shown):
        for before, (other, clear) in enumerate(shown[:number]):
            apart = cv2.absdiff(gray, other)
            apart = cv2.threshold(apart, DIFFERENT, DIFFERENT, cv2.THRESH_TRUNC)[1]
            if before == 0:
                apart = cv2.convertScaleAbs(apart, alpha=OWN)
            cv2.accumulate(apart, total, mask=cv2.bitwise_and(free, clear))
    views = np.sum([free > 0 for _, free in shown[1:]], axis=0)
    pairs = (views * (views - 1) / 2 + OWN * views * (shown[0][1] > 0)).astype(np.float32)
    square = (PATCH, PATCH)
    difference: Array = (cv2.blur(total, square) + UNKNOWN) / (cv2.blur(pairs, square) + 1)
    return difference


def _unlikely(hole: Hole, planes: _Planes, at: Array, inverse: Array, size: tuple[int, int]) -> Array:
    """Return what each plane costs because no point near by is near it, (h, w, d) float32."""
    region = hole.region
    rows, columns, number = region.height // CELL, region.width // CELL, len(planes.offsets)
    cell = np.floor((at - (region.x, region.y)) / CELL).clip(0, (columns - 1, rows - 1)).astype(int)
    votes = np.zeros((rows, columns, number), np.float32)
    np.add.at(votes, (cell[:, 1], cell[:, 0], planes.nearest(inverse - _plane_at(planes.plane, at))), 1)
    wide = np.zeros_like(votes)
    for layer in range(number):
        one = np.ascontiguousarray(votes[..., layer])
        if one.any():
            wide[..., layer] = sum(
                cv2.GaussianBlur(one, (0, 0), reach, borderType=cv2.BORDER_CONSTANT) for reach in REACH
            )
    beside = np.pad(wide, ((0, 0), (0, 0), (2, 2)))
    for k, share in enumerate((0.25, 0.7, 0.0, 0.7, 0.25)):
        wide += share * beside[..., k : k + number]
    cost = FAR * (1 - np.sqrt(np.minimum(wide / (ENOUGH * wide.max(axis=2, keepdims=True) + 1e-6), 1)))
    return np.dstack([cv2.resize(np.ascontiguousarray(cost[..., layer]), size) for layer in range(number)])


def _smoothed(cost: Array) -> Array:
    """Add to the cost of planes (h, w, d) what the neighbours' planes make of it, along rows and columns."""
    whole = np.zeros_like(cost)
    for axis, way in ((0, 1), (0, -1), (1, 1), (1, -1)):
        lines = np.ascontiguousarray(np.moveaxis(cost, axis, 0)[::way])
        for before, line in pairwise(lines):
            least = before.min(axis=1, keepdims=True)
            passed = np.minimum(before, least + JUMP)
            np.minimum(passed[:, 1:], before[:, :-1] + BEND, out=passed[:, 1:])
            np.minimum(passed[:, :-1], before[:, 1:] + BEND, out=passed[:, :-1])
            line += passed - least
        whole += np.moveaxis(lines[::way], 0, axis)
    return whole


def _lowest(cost: Array) -> Array:
    """Return the number of the cheapest plane, (h, w) float, between planes where a parabola says so."""
    best = cost.argmin(axis=2)
    inner = np.clip(best, 1, cost.shape[2] - 2)
    below, at, above = (np.take_along_axis(cost, inner[..., None] + k, 2)[..., 0] for k in (-1, 0, 1))
    bend = below + above - 2 * at
    fine = np.clip(0.5 * (below - above) / np.maximum(bend, 1e-6), -0.5, 0.5)
    return np.asarray(best + np.where((bend > 1e-6) & (best == inner), fine, 0))
