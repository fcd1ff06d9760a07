"""How far away the background behind a hole is: where the sources agree on what they see there.

Planes are tried one after the other: those on which points lie, and a sweep of planes parallel to the one on
which most of them do. Each source is laid onto a plane; where the plane is the background, the sources show
the same, whether or not the frame itself shows it. A pixel takes the plane on which they agree, on which its
neighbours lie, and near which points are known.
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
from orchestrator.make.planes import depth_at, planes_of
from orchestrator.make.scene_geometry import Relation
from orchestrator.make.source_frames import Source

__all__ = ["swept"]

#: Pixels of a sketch in each direction for one whose depth is looked for.
STRIDE = 2
#: Planes of the sweep, least and most, and by how much one displaces the background against the next, px.
PLANES, STEP_PX = (8, 40), 1.0
#: By how much a point may miss the plane on which it lies: px in the source that shows it most, but no more
#: than that share of all inverse depths.
TOLERANCE_PX, TOLERANCE_SHARE = 0.7, 0.05
#: A greater difference of two sources counts as this one, grey levels.
DIFFERENT = 40
#: How much more the frame itself has to say than a source.
OWN = 4
#: Side of the square over which differences are averaged, px of STRIDE.
PATCH = 7
#: What is taken for the difference where no two sources show a plane, grey levels.
UNKNOWN = 12.0
#: What a plane costs at most that is far from all points known, grey levels, and at which share of the votes
#: of the plane with most of them it costs nothing.
FAR, ENOUGH = 24.0, 0.5
#: What the farthest place costs more than the nearest: what agrees equally well is hidden by what is nearer,
#: grey levels.
HIDDEN = 6.0
#: What a plane of the sweep costs more than one on which points lie, grey levels.
SWEPT = 3.0
#: What a plane costs where nothing of the scene is as near or as far, grey levels.
IMPOSSIBLE = 100.0
#: How far the say of a point reaches, cells.
REACH = (1.0, 2.5, 6.0)
#: What it costs to lie on the plane of the sweep next to a neighbour's, and on any other, grey levels.
BEND, JUMP = 2.0, 5.0
#: Least and greatest change of light between two frames that is corrected, and which is none: pictures that
#: are not yet in place differ by as much.
GAIN, SAME_LIGHT = (0.6, 1.7), 0.07


@dataclass(frozen=True, slots=True)
class _Planes:
    """The planes tried.

    Attributes
    ----------
    all : (d + k, 3) float64
        First those of a sweep, evenly spaced, then those on which points lie.
    swept : int
        d
    step : float
        From one plane of the sweep to the next, inverse depth.
    """

    all: Array
    swept: int
    step: float


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
    usual = planes.all[planes.swept]  # on which most points lie
    lights = [
        _light(own, _shown(*cv2.split(_laid(picture, relation.of_plane(usual) @ grid, size))))
        for picture, relation in zip(pictures, relations, strict=True)
    ]
    pixels = cv2.resize(hole.pixels(), size, interpolation=cv2.INTER_AREA)
    depths = depth_at(planes.all, pixels[:, :, None])
    cost = np.empty(depths.shape, np.float32)
    for number, plane in enumerate(planes.all):
        shown = [own]
        for picture, relation, light in zip(pictures, relations, lights, strict=True):
            there, covered = cv2.split(_laid(picture, relation.of_plane(plane) @ grid, size))
            shown.append(_shown(there if light == 1.0 else cv2.convertScaleAbs(there, alpha=light), covered))
        cost[..., number] = _difference(shown)
    cost += _unlikely(hole, planes, at, inverse, size)
    cost[..., : planes.swept] += SWEPT
    least, most = inverse.min() - 2 * planes.step, inverse.max() + 2 * planes.step
    cost += HIDDEN * np.clip((most - depths) / (most - least), 0, 1).astype(np.float32)
    cost[(depths < least) | (depths > most)] += IMPOSSIBLE
    best, beyond = _lowest(_smoothed(cost, planes.swept), planes.swept)
    whole = (region.width, region.height)
    best = cv2.resize(best.astype(np.uint8), whole, interpolation=cv2.INTER_NEAREST)
    beyond = cv2.resize(beyond, whole, interpolation=cv2.INTER_NEAREST)
    return np.asarray(depth_at(planes.all[best], hole.pixels()) + beyond * planes.step, np.float32)


def _planes(hole: Hole, relations: Sequence[Relation], at: Array, inverse: Array) -> _Planes:
    """Find planes on which points lie, and planes between which all do, each a pixel from the next."""
    more = 0.01 * float(np.median(np.abs(inverse))) + 1e-9
    moved = _apart(relations, at, inverse, inverse + more).max(axis=0)
    wide = TOLERANCE_SHARE * float(np.ptp(np.quantile(inverse, (0.05, 0.95))))
    tolerance = np.minimum(TOLERANCE_PX * more / np.maximum(moved, 0.01), wide) + 1e-9
    found = planes_of(at, inverse, tolerance)
    near, far = np.quantile(inverse - depth_at(found[0], at), [0.01, 0.99])
    more = 0.1 * (far - near) + 1e-9
    near, far = near - more, far + more
    some = hole.pixels()[::16, ::16].reshape(-1, 2)
    usual = depth_at(found[0], some)
    apart = float(np.median(_apart(relations, some, usual + near, usual + far), axis=1).max())
    number = int(np.clip(np.ceil(apart / STEP_PX) + 1, *PLANES))
    offsets = np.linspace(near, far, number)
    parallel = found[0] + np.outer(offsets, [0, 0, 1.0])
    return _Planes(np.vstack([parallel, found]), number, float(offsets[1] - offsets[0]))


def _apart(relations: Sequence[Relation], points: Array, inverse: Array, other: Array) -> Array:
    """Return by how much two inverse depths (n,) displace pixels (n, 2) in each frame, (m, n) px."""
    return np.stack(
        [np.linalg.norm(one.places(points, other) - one.places(points, inverse), axis=1) for one in relations]
    )


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
    """Return what each plane costs because no point near by is near it, (h, w, d + k) float32."""
    region = hole.region
    rows, columns, number = region.height // CELL, region.width // CELL, len(planes.all)
    cell = np.floor((at - (region.x, region.y)) / CELL).clip(0, (columns - 1, rows - 1)).astype(int)
    off = np.abs(depth_at(planes.all, at[:, None]) - inverse[:, None]) / planes.step
    say = np.interp(off, (0.5, 1.0, 2.0, 3.0), (1.0, 0.7, 0.25, 0.0))
    wide = np.zeros((rows, columns, number), np.float32)
    for layer in range(number):
        votes = np.zeros((rows, columns), np.float32)
        np.add.at(votes, (cell[:, 1], cell[:, 0]), say[:, layer])
        wide[..., layer] = sum(
            cv2.GaussianBlur(votes, (0, 0), reach, borderType=cv2.BORDER_CONSTANT) for reach in REACH
        )
    cost = FAR * (1 - np.sqrt(np.minimum(wide / (ENOUGH * wide.max(axis=2, keepdims=True) + 1e-6), 1)))
    return np.dstack([cv2.resize(np.ascontiguousarray(cost[..., layer]), size) for layer in range(number)])


def _smoothed(cost: Array, swept: int) -> Array:
    """Add to the cost of planes (h, w, d) what the neighbours' planes make of it, along rows and columns."""
    whole = np.zeros_like(cost)
    for axis, way in ((0, 1), (0, -1), (1, 1), (1, -1)):
        lines = np.ascontiguousarray(np.moveaxis(cost, axis, 0)[::way])
        for before, line in pairwise(lines):
            least = before.min(axis=1, keepdims=True)
            passed = np.minimum(before, least + JUMP)
            there, sweep = passed[:, :swept], before[:, :swept]
            np.minimum(there[:, 1:], sweep[:, :-1] + BEND, out=there[:, 1:])
            np.minimum(there[:, :-1], sweep[:, 1:] + BEND, out=there[:, :-1])
            line += passed - least
        whole += np.moveaxis(lines[::way], 0, axis)
    return whole


def _lowest(cost: Array, swept: int) -> tuple[Array, Array]:
    """Return the number of the cheapest plane, (h, w) int, and how far beyond it a parabola ends, steps."""
    best = cost.argmin(axis=2)
    inner = np.clip(best, 1, swept - 2)
    below, at, above = (np.take_along_axis(cost, inner[..., None] + k, 2)[..., 0] for k in (-1, 0, 1))
    bend = below + above - 2 * at
    fine = np.clip(0.5 * (below - above) / np.maximum(bend, 1e-6), -0.5, 0.5)
    return best, np.where((bend > 1e-6) & (best == inner), fine, 0).astype(np.float32)
