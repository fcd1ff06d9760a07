"""Textures and outlines of synthetic scenes: band-limited noise, patches with edges, smooth shapes."""

from __future__ import annotations

import numpy as np
import scipy

from mlbs_actors.messages import Array

__all__ = ["blob", "capsule", "grain", "patchwork"]

PATCH_WAVELENGTH, DETAIL_WAVELENGTH = 24.0, 7.0  # canvas units
GRAIN_WAVELENGTH = 3.5  # px: a picture of any size has detail to follow
PATCH_TONES = 5


def grain(rng: np.random.Generator, shape: tuple[int, int], wavelength: float) -> Array:
    """Make Gaussian noise without waves much shorter than ``wavelength`` px; tiling, mean 0, deviation 1."""
    spectrum = scipy.fft.rfft2(rng.standard_normal(shape, dtype=np.float32))
    frequency = np.hypot(scipy.fft.fftfreq(shape[0])[:, None], scipy.fft.rfftfreq(shape[1])[None, :])
    spectrum *= np.exp(-((frequency * wavelength) ** 2)).astype(np.float32)
    spectrum[0, 0] = 0.0
    noise: Array = scipy.fft.irfft2(spectrum, s=shape)
    noise /= noise.std()
    return noise


def patchwork(
    rng: np.random.Generator,
    shape: tuple[int, int],
    colour: tuple[float, ...],
    unit: float,
    contrast: float = 36.0,
) -> Array:
    """Make patches of a few tones around a colour, with soft shading and grain: edges and corners everywhere.

    Parameters
    ----------
    rng : numpy Generator
    shape : (h, w)
        Size, px. The texture tiles in both directions.
    colour : (3,) float
        Mean colour, BGR, 0 … 255.
    unit : float
        px a canvas unit; the pattern keeps its size in canvas units.
    contrast : float
        How far the tones lie from the colour at most, grey levels.

    Returns
    -------
    (h, w, 3) uint8
    """
    fields = [grain(rng, shape, PATCH_WAVELENGTH * unit) for _ in range(PATCH_TONES)]
    tones = np.asarray(colour) + rng.uniform(-contrast, contrast, (PATCH_TONES, 1))
    tones += rng.uniform(-0.3, 0.3, (PATCH_TONES, 3)) * contrast
    texture = tones.astype(np.float32)[np.argmax(fields, axis=0)]
    texture = scipy.ndimage.gaussian_filter(texture, (0.7, 0.7, 0), mode="wrap", truncate=3.0)
    shading = 12 * grain(rng, shape, DETAIL_WAVELENGTH * unit)
    shading += 8 * grain(rng, shape, GRAIN_WAVELENGTH)
    texture += shading[:, :, None]
    return np.asarray(np.clip(texture + 0.5, 0, 255), np.uint8)


def blob(rng: np.random.Generator, size: tuple[float, float], unit: float, wobble: float = 0.12) -> Array:
    """Return the opacity of a smooth, random outline: an ellipse whose radius varies a few times around.

    Parameters
    ----------
    rng : numpy Generator
    size : (float, float)
        Half axes x, y, canvas units.
    unit : float
        px a canvas unit.
    wobble : float
        Amplitude of the variation relative to the radius.

    Returns
    -------
    (h, w) uint8, 0 … 255
        Centred; the edge is one px soft.
    """
    half = [int(np.ceil(axis * unit * 1.5)) + 2 for axis in size]
    y, x = np.mgrid[-half[1] : half[1] + 1, -half[0] : half[0] + 1] / unit
    around = np.arctan2(y / size[1], x / size[0])
    radius = np.ones_like(around)
    for swings in (2, 3, 5):
        amplitude, phase = wobble / swings**0.5 * rng.uniform(-1, 1), rng.uniform(0, 2 * np.pi)
        radius += amplitude * np.cos(swings * around + phase)
    inside = (radius - np.hypot(x / size[0], y / size[1])) * min(size) * unit
    return _opacity(inside)


def capsule(length: float, radius: float, unit: float) -> Array:
    """Return the opacity of an upright rod with round ends; ``length`` between its joints; canvas units."""
    half_width = int(np.ceil(radius * unit)) + 2
    half_height = int(np.ceil((length / 2 + radius) * unit)) + 2
    y, x = np.mgrid[-half_height : half_height + 1, -half_width : half_width + 1] / unit
    beyond = np.maximum(np.abs(y) - length / 2, 0)
    return _opacity((radius - np.hypot(x, beyond)) * unit)


def _opacity(inside: Array) -> Array:
    """Return 255 inside, 0 outside, with a ramp of one px; ``inside`` is the distance to the outline, px."""
    return (np.clip(inside + 0.5, 0, 1) * 255).round().astype(np.uint8)
