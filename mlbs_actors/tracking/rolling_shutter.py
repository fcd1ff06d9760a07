"""The swing of a rolling shutter: while a camera trembles its rows are read one after the other (§3).

Not in the paper. Each row then moves by itself, the whole picture in a wave: that is no homography, and
nothing in the picture does it. So where a homography fails for the background, a wave is fitted along with
it, and taken out of all motions if the two explain far more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mlbs_actors.config import TrajectoriesConfig
from mlbs_actors.messages import Array
from mlbs_actors.tracking.camera import camera_homography

__all__ = ["Swing", "swing_of_rows"]

#: Waves in the height of a picture that are tried, and then around the best of them.
WAVES, AROUND = np.arange(0.75, 5.1, 0.25), np.linspace(-0.2, 0.2, 17)
#: Steps of the robust fit, and most trajectories that it is made to.
FITS, MOST_POINTS = 3, 150
#: Fewest trajectories, the least share of them that an affine motion and a wave explain together, and most of
#: what the homography alone leaves that they leave.
LEAST_POINTS, LEAST_EXPLAINED, MOST_LEFT = 20, 0.7, 0.33


@dataclass(frozen=True, slots=True)
class Swing:
    """By how much each row has moved by itself since the frame before.

    Attributes
    ----------
    waves : float
        In the height of the picture.
    sine, cosine : (2,) float64
        Amplitudes of the backward motion along x and y, px.
    height : int
        Of the frame, px.
    """

    waves: float
    sine: Array
    cosine: Array
    height: int

    def at(self, rows: Array) -> Array:
        """Return the backward motion (n, 2) float32, px, at rows (n,), px."""
        angle = 2 * np.pi * self.waves / self.height * np.asarray(rows, np.float64)[:, None]
        return np.asarray(np.sin(angle) * self.sine + np.cos(angle) * self.cosine, np.float32)


def swing_of_rows(
    positions: Array, motions: Array, explained: float, height: int, scale: float, config: TrajectoriesConfig
) -> tuple[Swing, Array] | None:
    """Fit a wave of the rows to what a homography does not explain.

    Parameters
    ----------
    positions, motions : (n, 2) float32
        Background trajectories, evenly spread, and their backward motions, px.
    explained : float
        The share of them that a homography explains.
    height : int
        Of the frame, px.
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.
    config : TrajectoriesConfig

    Returns
    -------
    Swing
    (3, 3) float64
        The homography of the motions without it. None in place of both if the rows do not swing.
    """
    if len(positions) < LEAST_POINTS:
        return None
    noise = config.camera_inlier_px * scale
    some = slice(None, None, 1 + len(positions) // MOST_POINTS)
    coarse, _ = _best_wave(positions[some], motions[some], WAVES, height, noise)
    swing, left = _best_wave(positions[some], motions[some], coarse.waves + AROUND, height, noise)
    if left > 1 - LEAST_EXPLAINED or left >= MOST_LEFT * (1 - explained):
        return None
    return swing, camera_homography(positions, motions - swing.at(positions[:, 1]), scale, config)


def _best_wave(
    positions: Array, motions: Array, waves: Array, height: int, noise: float
) -> tuple[Swing, float]:
    """Find the wave, of some (w,), that with an affine motion explains most, by weighted least squares.

    Returns
    -------
    Swing
    float
        The share of the trajectories that the two do not explain.
    """
    x, y = positions.astype(np.float64).T / height
    angle = 2 * np.pi * waves[:, None] * y
    ones = np.ones_like(angle)
    basis = np.stack([ones, ones * x, ones * y, np.sin(angle), np.cos(angle)], axis=2)
    weight, error, amplitudes = ones, ones, np.zeros((len(waves), 5, 2))
    for _ in range(FITS):
        weighted = (basis * weight[..., None]).transpose(0, 2, 1)
        ridge = 1e-9 * len(x) * np.eye(5)  # all may lie in one row
        amplitudes = np.linalg.solve(weighted @ basis + ridge, weighted @ motions.astype(np.float64))
        error = np.square((motions - basis @ amplitudes) / noise).sum(axis=2)
        weight = 1 / (1 + error)
    best = int(np.log1p(error).mean(axis=1).argmin())
    swing = Swing(float(waves[best]), amplitudes[best, 3], amplitudes[best, 4], height)
    return swing, float((error[best] >= 1).mean())
