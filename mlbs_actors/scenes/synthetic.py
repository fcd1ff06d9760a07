"""Synthetic video with exact truth: textured surfaces under a moving camera, their labels and their motion.

A scene is a stack of textured *surfaces*, painted back to front: a far plane, a ground plane that runs from
the horizon towards the camera, things that stand on it, and labelled moving objects. Each surface has one
affine map a frame from its texture to the image; from these come the picture, the label of every pixel and
its exact backward motion. The camera translates in parallel to the image (so a plane's motion is affine in
the image, with parallax), rolls and zooms. A slight blur and sensor noise are added last.

Lengths are in canvas units, 320 to the width of the picture, so a scene looks alike at every size. A frame
depends on the scene's name, seed, size, length and the frame's index only, never on earlier calls. (The
pictures are sampled at 1/32 px, as OpenCV's warps do; labels and motion are exact for the maps.)
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from urllib.parse import parse_qsl

import cv2
import numpy as np

from mlbs_actors.errors import ConfigError
from mlbs_actors.messages import Array, Region
from mlbs_actors.scenes.scene_scripts import SCRIPTS, build_surfaces
from mlbs_actors.scenes.stage import Surface

__all__ = ["LIMITS", "SCHEME", "SyntheticScene", "scene", "scene_from_uri"]

#: Prefix of the URI of a scene: ``synthetic:NAME?frames=60&seed=1&width=640&height=480``.
SCHEME = "synthetic:"

LENS_BLUR = 0.6  # standard deviation, px
SENSOR_NOISE = 2.0  # standard deviation, grey levels
#: Least and largest value of each parameter of a scene.
LIMITS = {
    "frames": (1, 100_000),
    "seed": (0, 2**32 - 1),
    "width": (32, 4096),
    "height": (32, 4096),
    "objects": (1, 32),
}


def scene(
    name: str,
    *,
    frames: int = 60,
    seed: int = 0,
    width: int = 320,
    height: int = 240,
    objects: int | None = None,
) -> SyntheticScene:
    """Make a scene by name.

    Parameters
    ----------
    name : str
        One of ``mlbs_actors.scenes.scene_scripts.SCRIPTS``, where each is described.
    frames : int
        Length, 1 … 100,000.
    seed : int
        Other textures, outlines and noise, same events; 0 … 2³² − 1.
    width, height : int
        Size, px, 32 … 4096.
    objects : int, optional
        Number of objects, 1 … 32; only for a scene without a fixed number.

    Returns
    -------
    SyntheticScene

    Raises
    ------
    ConfigError
        If there is no such scene, a value is out of its range, or ``objects`` is not for this scene.
    """
    if name not in SCRIPTS:
        raise ConfigError(
            f"There is no synthetic scene {name!r}; choose one of {', '.join(sorted(SCRIPTS))}."
        )
    given = {"frames": frames, "seed": seed, "width": width, "height": height}
    if objects is not None:
        if SCRIPTS[name].objects is None:
            choosable = ", ".join(scene for scene, script in SCRIPTS.items() if script.objects is not None)
            raise ConfigError(
                f"The synthetic scene {name!r} has its own objects; leave objects out, or take {choosable}."
            )
        given["objects"] = objects
    for parameter, value in given.items():
        low, high = LIMITS[parameter]
        if not low <= value <= high:
            raise ConfigError(f"{parameter} of a synthetic scene is {value}; it must be {low} to {high}.")
    key = zlib.crc32(name.encode())
    surfaces = build_surfaces(name, frames, np.random.default_rng([seed, key]), width, height, objects)
    return SyntheticScene(name, frames, seed, width, height, surfaces, SENSOR_NOISE)


def scene_from_uri(uri: str) -> SyntheticScene:
    """Make the scene of a URI such as ``synthetic:demo?frames=60&seed=1&width=640&height=480``.

    Raises
    ------
    ConfigError
        If it is no such URI, or names an unknown scene or parameter.
    """
    if not uri.startswith(SCHEME):
        raise ConfigError(f"{uri!r} is no synthetic scene; write {SCHEME}NAME?frames=60&seed=1.")
    name, _, query = uri.removeprefix(SCHEME).partition("?")
    parameters: dict[str, int] = {}
    for parameter, text in parse_qsl(query, keep_blank_values=True):
        if parameter not in LIMITS or parameter in parameters or not text.isdecimal():
            raise ConfigError(
                f"Cannot use {parameter}={text} in {uri!r}; the parameters are {', '.join(LIMITS)}, "
                "each a whole number, each at most once."
            )
        parameters[parameter] = int(text[:12])
    return scene(name, **parameters)


@dataclass(frozen=True, eq=False)
class SyntheticScene:
    """A video with exact labels and motion, by frame index; made by :func:`scene`.

    Attributes
    ----------
    name : str
    frames : int
    seed : int
    width, height : int
    surfaces : tuple of Surface
        Back to front.
    noise : float
        Standard deviation of the sensor noise, grey levels.
    """

    name: str
    frames: int
    seed: int
    width: int
    height: int
    surfaces: tuple[Surface, ...]
    noise: float

    def __len__(self) -> int:
        return self.frames

    def frame(self, index: int) -> Array:
        """Picture ``index``, (H, W, 3) uint8 BGR. IndexError outside 0 … frames − 1."""
        self._check(index)
        picture = np.zeros((self.height, self.width, 3), np.uint8)
        for number, region, opacity in self._coverage(index):
            surface = self.surfaces[number]
            border = cv2.BORDER_WRAP if surface.opacity is None else cv2.BORDER_REPLICATE
            colours = _warp(surface.texture, surface.maps[index], region, border)
            patch = picture[region.slices]
            if opacity is None:
                patch[:] = colours
            else:
                share = opacity[:, :, None].astype(np.uint16)
                patch[:] = (colours * share + patch * (255 - share) + 127) // 255
        seen = cv2.GaussianBlur(picture, (3, 3), LENS_BLUR)
        if self.noise == 0:
            return seen
        rng = np.random.default_rng([self.seed, zlib.crc32(self.name.encode()), index])
        noise = rng.standard_normal(seen.shape, dtype=np.float32)
        noisy: Array = np.clip(seen + self.noise * noise + 0.5, 0, 255).astype(np.uint8)
        return noisy

    def labels(self, index: int) -> Array:
        """Truth ids of picture ``index``, (H, W) uint8, 0 = background. IndexError as :meth:`frame`."""
        ids: Array = np.array([surface.label for surface in self.surfaces], np.uint8)
        seen: Array = ids[self.surface_numbers(index)]
        return seen

    def flow(self, index: int) -> Array:
        """Return the exact backward motion of picture ``index``: where each pixel was one picture before.

        Returns
        -------
        (H, W, 2) float32
            Displacement (x, y) to the picture before, px; zeros for picture 0. It is that of the surface seen
            at the pixel, even if it was hidden or outside the picture before.

        Raises
        ------
        IndexError
            As :meth:`frame`.
        """
        motion = np.zeros((self.height, self.width, 2), np.float32)
        owners = self.surface_numbers(index)
        if index == 0:
            return motion
        for number in np.flatnonzero(np.bincount(owners.ravel())).tolist():
            maps = self.surfaces[number].maps
            back = _homogeneous(maps[index - 1]) @ np.linalg.inv(_homogeneous(maps[index])) - np.eye(3)
            y, x = np.nonzero(owners == number)
            motion[y, x, 0] = back[0, 0] * x + back[0, 1] * y + back[0, 2]
            motion[y, x, 1] = back[1, 0] * x + back[1, 1] * y + back[1, 2]
        return motion

    def surface_numbers(self, index: int) -> Array:
        """Place in ``surfaces`` of the one seen at each pixel, (H, W) uint16. IndexError as :meth:`frame`."""
        self._check(index)
        owners = np.zeros((self.height, self.width), np.uint16)
        for number, region, opacity in self._coverage(index):
            if opacity is None:
                owners[region.slices] = number
            else:
                owners[region.slices][opacity >= 128] = number
        return owners

    def _check(self, index: int) -> None:
        if not 0 <= index < self.frames:
            raise IndexError(f"frame {index} of {self.frames}; frames count from 0")

    def _coverage(self, index: int) -> Iterator[tuple[int, Region, Array | None]]:
        """Yield back to front: surface number, the region it can touch, its opacity there (None: opaque)."""
        whole = Region(0, 0, self.width, self.height)
        for number, surface in enumerate(self.surfaces):
            image_map = surface.maps[index]
            if surface.opacity is not None:
                region = _image_bounds(surface.opacity.shape, image_map, whole)
                if region.area:
                    yield number, region, _warp(surface.opacity, image_map, region, cv2.BORDER_CONSTANT)
            elif surface.top_row is not None:
                yield number, whole, _below(surface.top_row, image_map, whole)
            else:
                yield number, whole, None


def _homogeneous(image_map: Array) -> Array:
    return np.vstack([image_map, [0.0, 0.0, 1.0]])


def _warp(texture: Array, image_map: Array, region: Region, border: int) -> Array:
    """Warp the texture into a region of the image."""
    shifted = image_map.copy()
    shifted[:, 2] -= (region.x, region.y)
    size = (region.width, region.height)
    return cv2.warpAffine(texture, shifted, size, flags=cv2.INTER_LINEAR, borderMode=border)


def _image_bounds(shape: tuple[int, ...], image_map: Array, whole: Region) -> Region:
    """Return the part of the image that a texture of this shape can touch."""
    height, width = shape
    corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]], np.float64)
    seen = corners @ image_map.T
    low = np.clip(np.floor(seen.min(axis=0)).astype(int) - 1, 0, (whole.width, whole.height))
    high = np.clip(np.ceil(seen.max(axis=0)).astype(int) + 2, 0, (whole.width, whole.height))
    return Region(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))


def _below(top_row: float, image_map: Array, region: Region) -> Array:
    """Return the opacity (255 or 0, one px soft) of an unbounded plane from a row of its texture on."""
    inverse = np.linalg.inv(_homogeneous(image_map))
    x = np.arange(region.x, region.x + region.width)
    y = np.arange(region.y, region.y + region.height)[:, None]
    row = inverse[1, 0] * x + inverse[1, 1] * y + inverse[1, 2]
    opacity: Array = np.clip(row - top_row + 0.5, 0, 1) * 255
    return opacity.round().astype(np.uint8)
