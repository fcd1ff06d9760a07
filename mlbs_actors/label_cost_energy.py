"""The energy of a labelling, of a whole image and of the pixels that are still open (§7).

E(L) = Σ_p U_p(l_p) + Σ_pq w_pq [l_p ≠ l_q] + Σ_k h_k δ_k(L), in integers of any unit. Where some pixels have
their label for good, the others have an energy of their own, into whose unary terms those neighbours are
folded.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit

from mlbs_actors.messages import Array

__all__ = [
    "NEIGHBOUR_OFFSETS",
    "UNDECIDED",
    "LabelCostEnergy",
    "UndecidedEnergy",
    "neighbour_and_weight",
    "undecided_energy",
]

#: Label of a pixel that has none yet.
UNDECIDED = -1

#: (dy, dx) of the eight neighbours; entry k + 4 is the opposite of entry k.
NEIGHBOUR_OFFSETS = np.array([(0, 1), (1, 0), (1, 1), (1, -1), (0, -1), (-1, 0), (-1, -1), (-1, 1)])


@dataclass(frozen=True, slots=True)
class LabelCostEnergy:
    """E(L) of an (H, W) image and K labels, in integers of any unit.

    Attributes
    ----------
    unary : (K, ⌈H / side⌉, ⌈W / side⌉) int32
        Cost of each label at each pixel of a cell, at most 2²⁴ in size.
    weights : (H, W, 4) int32
        Potts weight to the neighbour at ``NEIGHBOUR_OFFSETS[k]``, k < 4, in 0 … 2²⁴; 0 where it would be
        outside the image.
    label_costs : (K,) int64
        Cost of using a label at all, ≥ 0.
    side : int
        Of the square cells whose pixels share their unary costs.
    extras : (n, 4) int64
        Label, row, column, and what is added to that label's unary cost at that pixel alone.
    """

    unary: Array
    weights: Array
    label_costs: Array
    side: int = 1
    extras: Array = field(default_factory=lambda: np.zeros((0, 4), np.int64))

    def of_pixels(self) -> LabelCostEnergy:
        """The same energy with a unary cost for each pixel, (K, H, W)."""
        if self.side == 1 and len(self.extras) == 0:
            return self
        height, width = self.weights.shape[:2]
        unary = self.unary.repeat(self.side, axis=1).repeat(self.side, axis=2)[:, :height, :width].copy()
        np.add.at(unary, tuple(self.extras[:, :3].T), self.extras[:, 3].astype(np.int32))
        return LabelCostEnergy(unary, self.weights, self.label_costs)

    def energy(self, labels: Array) -> int:
        """E(labels) of label positions (H, W) intp."""
        used = np.bincount(labels.reshape(-1), minlength=self.label_costs.size) > 0
        pixel_terms = _image_energy(self.of_pixels().unary, self.weights, labels)
        return int(pixel_terms) + int(self.label_costs[used].sum())


@dataclass(frozen=True, slots=True)
class UndecidedEnergy:
    """The energy that is left on the n undecided pixels, up to a constant, in the unit of the whole.

    Attributes
    ----------
    pixels : (n,) intp
        Flat index in the image, ascending.
    row : (n,) intp
        Image row.
    unary : (K, n) int32
        With the pair terms to decided neighbours folded in.
    neighbour : (n, 8) int32
        Position in ``pixels`` of each neighbour, −1 where there is none or it is decided.
    weight : (n, 8) int32
        Potts weight to it, 0 where there is none.
    label_costs : (K,) int64
        0 for the labels that decided pixels hold.
    elsewhere : (K,) bool
        Labels that decided pixels hold.
    """

    pixels: Array
    row: Array
    unary: Array
    neighbour: Array
    weight: Array
    label_costs: Array
    elsewhere: Array

    def used(self, labels: Array) -> Array:
        """(K,) bool: labels in use anywhere in the image, given those of the undecided pixels, (n,) intp."""
        in_use: Array = self.elsewhere | (np.bincount(labels, minlength=self.elsewhere.size) > 0)
        return in_use

    def energy(self, labels: Array) -> int:
        """Energy of a labelling (n,) intp of the undecided pixels."""
        pixel_terms = _energy(self.unary, self.neighbour, self.weight, labels)
        return int(pixel_terms) + int(self.label_costs[self.used(labels)].sum())


def undecided_energy(whole: LabelCostEnergy, labels: Array, elsewhere: Array) -> UndecidedEnergy:
    """The energy that is left where some pixels have their label.

    Parameters
    ----------
    whole : LabelCostEnergy
    labels : (H, W) intp
        ``UNDECIDED`` where it is open.
    elsewhere : (K,) bool
        Labels that the others hold.

    Returns
    -------
    UndecidedEnergy
    """
    pixels = np.flatnonzero(labels == UNDECIDED)
    neighbour, weight = _around(whole.weights, labels, pixels)
    return UndecidedEnergy(
        pixels,
        pixels // labels.shape[1],
        _folded(whole.unary, whole.side, whole.extras, whole.weights, labels, pixels),
        neighbour,
        weight,
        np.where(elsewhere, 0, whole.label_costs),
        elsewhere,
    )


@njit(cache=True)
def neighbour_and_weight(y: int, x: int, k: int) -> tuple[int, int, int, int, int]:
    """Row and column of a neighbour, and where the weight to it is found: row, column and direction."""
    v, u = y + NEIGHBOUR_OFFSETS[k, 0], x + NEIGHBOUR_OFFSETS[k, 1]
    if k < 4:
        return v, u, y, x, k
    return v, u, v, u, k - 4


@njit(cache=True)
def _folded(unary: Array, side: int, extras: Array, weights: Array, labels: Array, pixels: Array) -> Array:
    """Unary (K, n) of the undecided pixels with the pair terms to decided neighbours."""
    label_count, _, columns = unary.shape
    height, width = labels.shape
    cells = np.empty(pixels.size, np.intp)
    for i in range(pixels.size):
        cells[i] = pixels[i] // width // side * columns + pixels[i] % width // side
    folded = np.empty((label_count, pixels.size), np.int32)
    for label in range(label_count):
        own = unary[label].reshape(-1)
        for i in range(pixels.size):
            folded[label, i] = own[cells[i]]
    for i in range(pixels.size):
        y, x = pixels[i] // width, pixels[i] % width
        for k in range(8):
            v, u, row, column, direction = neighbour_and_weight(y, x, k)
            if 0 <= v < height and 0 <= u < width and labels[v, u] != UNDECIDED:
                # As in the test above: up to a constant, agreeing with it saves the weight.
                folded[labels[v, u], i] -= weights[row, column, direction]
    for extra in range(extras.shape[0]):
        pixel = extras[extra, 1] * width + extras[extra, 2]
        i = np.searchsorted(pixels, pixel)
        if i < pixels.size and pixels[i] == pixel:
            folded[extras[extra, 0], i] += extras[extra, 3]
    return folded


@njit(cache=True)
def _around(weights: Array, labels: Array, pixels: Array) -> tuple[Array, Array]:
    """Neighbours (n, 8) of the undecided pixels among themselves, and the weights to them."""
    height, width = labels.shape
    position = np.full((height, width), -1, np.int32)
    for i in range(pixels.size):
        position[pixels[i] // width, pixels[i] % width] = i
    neighbour, weight = np.full((pixels.size, 8), -1, np.int32), np.zeros((pixels.size, 8), np.int32)
    for i in range(pixels.size):
        y, x = pixels[i] // width, pixels[i] % width
        for k in range(4):
            w = weights[y, x, k]
            if w > 0:
                j = position[y + NEIGHBOUR_OFFSETS[k, 0], x + NEIGHBOUR_OFFSETS[k, 1]]
                if j >= 0:
                    neighbour[i, k], weight[i, k] = j, w
                    neighbour[j, k + 4], weight[j, k + 4] = i, w
    return neighbour, weight


@njit(cache=True)
def _image_energy(unary: Array, weights: Array, labels: Array) -> np.int64:
    """Unary and pair terms; the first four neighbours name each pair once."""
    total = np.int64(0)
    height, width = labels.shape
    for y in range(height):
        for x in range(width):
            label = labels[y, x]
            total += unary[label, y, x]
            for k in range(4):
                w = weights[y, x, k]
                if w > 0 and labels[y + NEIGHBOUR_OFFSETS[k, 0], x + NEIGHBOUR_OFFSETS[k, 1]] != label:
                    total += w
    return total


@njit(cache=True)
def _energy(unary: Array, neighbour: Array, weight: Array, labels: Array) -> np.int64:
    """Unary and pair terms; the first four neighbours name each pair once."""
    total = np.int64(0)
    for p in range(labels.size):
        total += unary[labels[p], p]
        for k in range(4):
            q = neighbour[p, k]
            if q >= 0 and labels[q] != labels[p]:
                total += weight[p, k]
    return total
