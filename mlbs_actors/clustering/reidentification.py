"""Re-identification: whether a new cluster is an object that was lost, by its colours and its place (§4).

Differs from the paper, which never resumes an object. A new cluster is a lost object if colour and place
together say so, each with the likelihood ratio that was measured (docs/experiments/identity.md). The longer
an object has been hidden, the less its place says. Its colours are those of all its trajectories, so that the
last edge that disappeared weighs little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mlbs_actors.config import IdentityConfig, length_scale
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["SIGNATURE_BINS", "Sighting", "colour_odds", "colour_signatures", "colours_at", "return_odds"]

#: Bins a colour channel of a signature.
SIGNATURE_BINS = 6


@dataclass(frozen=True, slots=True)
class Sighting:
    """Objects as last seen, one in each row.

    Attributes
    ----------
    seen : (k,) int64
        Frame.
    centroids, velocities : (k, 2) float64
        Mean position (px) and forward motion (px/frame).
    signatures : (k, SIGNATURE_BINS³) float32
        Colour histograms, of any sum.
    """

    seen: Array
    centroids: Array
    velocities: Array
    signatures: Array


@compiled
def colours_at(cells: Array, positions: Array, side: int) -> Array:
    """Return the colours of the cells (h, w, 3) of ``side`` px in which some positions (n, 2) lie: (n, 3)."""
    colours = np.empty((positions.shape[0], 3), np.uint8)
    for i in range(positions.shape[0]):
        x = min(max(int(np.rint(positions[i, 0])) // side, 0), cells.shape[1] - 1)
        y = min(max(int(np.rint(positions[i, 1])) // side, 0), cells.shape[0] - 1)
        for channel in range(3):
            colours[i, channel] = cells[y, x, channel]
    return colours


@compiled
def colour_signatures(rows: Array, colours: Array, count: int) -> Array:
    """Compute colour histograms of groups of pixels.

    Parameters
    ----------
    rows : (n,) int64
        Group of each pixel, −1 for none.
    colours : (n, 3) uint8
    count : int
        Number of groups.

    Returns
    -------
    (count, SIGNATURE_BINS³) float32
        Numbers of pixels.
    """
    histograms = np.zeros((count, SIGNATURE_BINS**3), np.float32)
    for i in range(rows.size):
        if rows[i] >= 0:
            place = np.int64(0)
            for channel in range(3):
                place = place * SIGNATURE_BINS + np.int64(colours[i, channel]) * SIGNATURE_BINS // 256
            histograms[rows[i], place] += 1
    return histograms


def colour_odds(signature: Array, other: Array, config: IdentityConfig) -> float:
    """Return the log-likelihood ratio that two clusters of these colours are one thing and not two, nats.

    Parameters
    ----------
    signature, other : (SIGNATURE_BINS³,) float32
        Colour histograms, of any sum.
    config : IdentityConfig
    """
    pairs = float(signature.sum()) * float(other.sum())
    likeness = float(np.sqrt(signature * other).sum()) / max(pairs, 1.0) ** 0.5
    return config.bounded(config.colour_slope * (likeness - config.colour_likeness))


def return_odds(
    centroid: Array,
    signature: Array,
    lost: Sighting,
    frame_index: int,
    shape: tuple[int, int],
    config: IdentityConfig,
) -> Array:
    """Compute the log-odds that a new cluster is each of some lost objects, by its colours and its place.

    Parameters
    ----------
    centroid : (2,) float64
        Of the cluster, px.
    signature : (SIGNATURE_BINS³,) float32
        Its colour histogram, of any sum.
    lost : Sighting
    frame_index : int
        The present frame.
    shape : (H, W)
        px.
    config : IdentityConfig

    Returns
    -------
    (k,) float64
        Nats. Each term is bounded, so that the other one can outweigh it.
    """
    even = config.place_px * length_scale(*shape)
    odds = np.empty(len(lost.seen))
    for row, gap in enumerate(frame_index - lost.seen):
        expected = lost.centroids[row] + gap * lost.velocities[row]
        places, prior = [expected], 0.0
        if (expected >= 0).all() and (expected < shape[::-1]).all():
            # It is hidden, and may have been slower than expected, or have turned.
            places.append(lost.centroids[row])
        else:
            # What has left the frame seldom comes back: both colour and place must speak for it.
            prior = -config.most_evidence
        distance = min(float(np.hypot(*(centroid - place))) for place in places)
        slope = config.place_slope / (1 + gap / config.place_frames)
        near = -slope * math.log(max(distance, 1e-3) / even)
        colours = colour_odds(signature, lost.signatures[row], config)
        odds[row] = prior + config.bounded(near) + colours
    return odds
