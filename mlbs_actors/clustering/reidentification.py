"""Re-identification: whether a new cluster is an object that was lost, by its colours and its place (§4).

Differs from the paper, which never resumes an object. The longer an object has been hidden, the farther it
can be from where it is expected. What tells it from others are the colours of all its trajectories, so that
those of the last edge that disappeared weigh little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mlbs_actors.config import LayersConfig, length_scale
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["SIGNATURE_BINS", "Sighting", "best_sleeper", "colour_signatures", "colours_at"]

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
def colours_at(frame: Array, positions: Array) -> Array:
    """Return the colours of the pixels nearest to some positions, (n, 3) uint8."""
    colours = np.empty((positions.shape[0], 3), np.uint8)
    for i in range(positions.shape[0]):
        x = min(max(int(np.rint(positions[i, 0])), 0), frame.shape[1] - 1)
        y = min(max(int(np.rint(positions[i, 1])), 0), frame.shape[0] - 1)
        for channel in range(3):
            colours[i, channel] = frame[y, x, channel]
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


def best_sleeper(
    centroid: Array,
    signature: Array,
    sleepers: Sighting,
    frame_index: int,
    shape: tuple[int, int],
    config: LayersConfig,
) -> int | None:
    """Find the lost object that best explains a new cluster by colour and place.

    Parameters
    ----------
    centroid : (2,) float64
        Of the cluster, px.
    signature : (SIGNATURE_BINS³,) float32
        Its colour histogram, of any sum.
    sleepers : Sighting
    frame_index : int
        The present frame.
    shape : (H, W)
        px.

    Returns
    -------
    int or None
        Its row; None if none is near and similar enough.
    """
    best, chosen = config.wake_similarity, None
    for row, gap in enumerate(frame_index - sleepers.seen):
        expected = sleepers.centroids[row] + gap * sleepers.velocities[row]
        places, within = [expected], config.wake_px * length_scale(*shape)
        if (expected >= 0).all() and (expected < shape[::-1]).all():
            # It is hidden, and may have been slower than expected, or have turned. If it has left the frame,
            # a cluster where it left is another object.
            places.append(sleepers.centroids[row])
            within *= 1 + gap / max(config.dormant_frames, 1)
        if min(float(np.hypot(*(centroid - place))) for place in places) > within:
            continue
        known = sleepers.signatures[row]
        pairs = float(signature.sum()) * float(known.sum())
        likeness = float(np.sqrt(signature * known).sum()) / max(pairs, 1.0) ** 0.5
        if likeness > best:
            best, chosen = likeness, row
    return chosen
