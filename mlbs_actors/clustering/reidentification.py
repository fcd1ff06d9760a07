"""Re-identification: whether a new cluster is an object that was lost, by its colours and its place (§4).

Differs from the paper, which never resumes an object.
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
        Of :func:`colour_signatures`.
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
    """Compute normalised colour histograms of groups of pixels.

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
        Sum 1, or 0 for a group without pixels.
    """
    histograms, pixels = np.zeros((count, SIGNATURE_BINS**3), np.float32), np.zeros(count, np.float32)
    for i in range(rows.size):
        if rows[i] >= 0:
            place = np.int64(0)
            for channel in range(3):
                place = place * SIGNATURE_BINS + np.int64(colours[i, channel]) * SIGNATURE_BINS // 256
            histograms[rows[i], place] += 1
            pixels[rows[i]] += 1
    for row in range(count):
        histograms[row] /= max(pixels[row], np.float32(1))
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
        places = [expected]
        if (expected >= 0).all() and (expected < shape[::-1]).all():
            # It may have been slower than expected, unless it has left the frame: a cluster where it left is
            # another object.
            places.append(sleepers.centroids[row])
        nearest = min(float(np.hypot(*(centroid - place))) for place in places)
        if nearest > config.wake_px * length_scale(*shape):
            continue
        likeness = float(np.sqrt(signature * sleepers.signatures[row]).sum())
        if likeness > best:
            best, chosen = likeness, row
    return chosen
