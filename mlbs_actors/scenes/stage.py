"""The stage of a synthetic scene: a camera's path, and pieces placed in front of it, far and near.

Canvas units: 320 to the width of the picture; (0, 0) is its centre, y down. An object's path is either in the
*view* (it goes along with the camera, so it stays in sight however long the scene) or in the *world*.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.scenes.street import Piece, facades, road, tree
from mlbs_actors.scenes.textures import blob, capsule, patchwork

__all__ = ["CANVAS", "SLOPE", "Stage", "Surface"]

CANVAS = 320.0  # units to the width of the picture
TILE = 512  # side of the texture of a plane, which repeats, units
HORIZON = -25.0  # height at which the ground begins in the first frame, units
SLOPE = 0.006  # increase of nearness per unit below the horizon; nearness 1 is the far plane
PAN_REACH = 160.0  # how far the camera pans before it turns, units
FAR_COLOUR, GROUND_COLOUR, PROP_COLOUR = (136.0, 128.0, 112.0), (96.0, 106.0, 112.0), (78.0, 112.0, 96.0)


@dataclass(frozen=True, eq=False)
class Surface:
    """One textured, rigid piece of a scene.

    Attributes
    ----------
    label : int
        Truth id; 0 = background.
    texture : (h, w, 3) uint8 BGR
        Repeats where ``opacity`` is None.
    opacity : (h, w) uint8 or None
        0 = clear; None: unbounded.
    top_row : float or None
        Row of the texture, px, above which an unbounded surface is clear; None: it covers all.
    maps : (frames, 2, 3) float64
        For each frame the affine map of texture px (x, y, 1) to image px.
    """

    label: int
    texture: Array
    opacity: Array | None
    top_row: float | None
    maps: Array


@dataclass
class Stage:
    """A scene under construction: the camera first, then what it sees.

    All paths are arrays with one entry a frame. ``x``, ``y``: the camera's translation, units; ``roll``: rad.
    ``objects``: number of objects in a scene without a fixed number.
    """

    frames: int
    rng: np.random.Generator
    width: int
    height: int
    objects: int
    x: Array = field(init=False)
    y: Array = field(init=False)
    roll: Array = field(init=False)
    zoom: Array = field(init=False)
    slope: float = SLOPE
    placed: list[tuple[float, Surface]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.x, self.y, self.roll = np.zeros((3, self.frames))
        self.zoom = np.ones(self.frames)

    @property
    def time(self) -> Array:
        """Frame numbers, (frames,) float64."""
        return np.arange(self.frames, dtype=np.float64)

    @property
    def unit(self) -> float:
        """px per canvas unit."""
        return self.width / CANVAS

    @property
    def tallness(self) -> float:
        """Height of the picture relative to 4:3; heights in the view scale with it."""
        return self.height / (0.75 * self.width)

    def pan(self, speed: float) -> None:
        """Pan at about ``speed`` units a frame, reversing smoothly at the ends, with an unsteady hand."""
        self.x = PAN_REACH * np.sin(self.time * speed / PAN_REACH)
        self.x += 0.5 * np.sin(self.time * 0.61 + 1.0) - 0.5 * np.sin(1.0)
        self.y = 0.8 * np.sin(self.time * 0.37)

    def nearness(self, foot: float) -> float:
        """Return the parallax of something that stands on the ground at this height of the canvas."""
        return 1.0 + self.slope * max(foot - HORIZON, 0.0)

    def background(self, props: int = 7) -> None:
        """Add far plane, ground, and bushes that stand on it."""
        self._plane(FAR_COLOUR, 1.0, 0.0, None)
        self._plane(GROUND_COLOUR, 1.0 - self.slope * HORIZON, self.slope, HORIZON)
        for place in np.linspace(-1.6, 1.6, props):
            size = (self.rng.uniform(10, 22), self.rng.uniform(10, 20))
            foot = HORIZON + self.rng.uniform(8, 50)
            path = np.tile((place * CANVAS / 2 + self.rng.uniform(-15, 15), foot - size[1]), (self.frames, 1))
            self._bounded(BACKGROUND, blob(self.rng, size, self.unit), PROP_COLOUR, path, self.nearness(foot))

    def thing(
        self,
        label: int,
        path: tuple[Array | float, Array | float],
        size: tuple[float, float],
        *,
        in_world: bool = False,
        rotation: Array | float = 0.0,
    ) -> None:
        """Add a moving object with its own outline and texture.

        Parameters
        ----------
        label : int
        path : (x, y)
            Its centre, units, (frames,) or constant.
        size : (float, float)
            Half axes, units.
        in_world : bool
            False: the path is in the view.
        rotation : (frames,) or constant
            Its rotation, rad.
        """
        centre = self._path(path)
        nearness = self.nearness(float(centre[0, 1]) + size[1])
        if not in_world:
            centre = centre + nearness * np.stack([self.x, self.y], axis=1)
        colour = _object_colour(self.rng)
        self._bounded(label, blob(self.rng, size, self.unit), colour, centre, nearness, rotation)

    def walker(self, label: int, path: tuple[Array | float, Array | float], tall: float) -> None:
        """Add a figure that walks along a path of its hip (units, in the view): swinging legs and arms."""
        hip = self._path(path)
        leg, trunk, arm = 0.25 * tall, 0.3 * tall, 0.17 * tall
        nearness = self.nearness(float(hip[0, 1]) + 2 * leg)
        hip = hip + nearness * np.stack([self.x, self.y], axis=1)
        shoulder = hip - (0.0, trunk)
        trousers, shirt = _object_colour(self.rng), _object_colour(self.rng)
        stride = self.time * 2 * np.pi / 26

        def limb(joint: Array, angle: Array, length: float, thick: float, colour: tuple[float, ...]) -> Array:
            """Place a limb that hangs from a joint; return its lower end."""
            along = np.stack([-np.sin(angle), np.cos(angle)], axis=1) * length
            shape = capsule(length, thick, self.unit)
            self._bounded(label, shape, colour, joint + along / 2, nearness, angle)
            return joint + along

        for side in (0.0, np.pi):
            swing = 0.55 * np.sin(stride + side)
            knee = limb(hip, swing, leg, 0.055 * tall, trousers)
            limb(knee, swing - 0.45 * (1 + np.cos(stride + side)), leg, 0.045 * tall, trousers)
            elbow = limb(shoulder, -0.8 * swing, arm, 0.04 * tall, shirt)
            limb(elbow, -0.8 * swing + 0.35, arm, 0.035 * tall, shirt)
        still = np.zeros(self.frames)
        limb(shoulder, still, trunk, 0.09 * tall, shirt)
        limb(shoulder - (0.0, 0.17 * tall), still, 0.03 * tall, 0.07 * tall, (110.0, 140.0, 180.0))

    def street(self, trees: int = 6) -> None:
        """Add houses, a road before them, and trees on the pavement, instead of :meth:`background`."""
        side = round(TILE * self.unit)
        houses = facades(self.texture_rng(), TILE, self.unit, HORIZON)
        self._unbounded(houses, 1.0, 0.0, None)
        self._unbounded(
            road(self.texture_rng(), side, self.unit), 1.0 - self.slope * HORIZON, self.slope, HORIZON
        )
        for place in np.linspace(-1.6, 1.6, trees):
            size, foot = self.rng.uniform(12, 18), HORIZON + self.rng.uniform(8, 20)
            centre = (place * CANVAS / 2 + self.rng.uniform(-15, 15), foot - 1.4 * size)
            path = np.tile(centre, (self.frames, 1))
            self._piece(BACKGROUND, tree(self.texture_rng(), size, self.unit), path, self.nearness(foot))

    def painted(self, label: int, piece: Piece, path: tuple[Array | float, Array | float]) -> None:
        """Add a moving object with a finished picture; its path is in the view."""
        centre = self._path(path)
        nearness = self.nearness(float(centre[0, 1]) + piece[1].shape[0] / 2 / self.unit)
        self._piece(label, piece, centre + nearness * np.stack([self.x, self.y], axis=1), nearness)

    def surfaces(self) -> tuple[Surface, ...]:
        """Return everything placed, far to near; equally near things in the order of placing."""
        return tuple(surface for _, surface in sorted(self.placed, key=lambda entry: entry[0]))

    def _path(self, path: tuple[Array | float, Array | float]) -> Array:
        x, y = (np.broadcast_to(np.asarray(axis, np.float64), (self.frames,)) for axis in path)
        return np.stack([x, y * self.tallness], axis=1)

    def texture_rng(self) -> np.random.Generator:
        """Generator for one texture: a larger texture draws more numbers, which must not alter outlines."""
        return np.random.default_rng(self.rng.integers(2**63))

    def _plane(self, colour: tuple[float, ...], nearness: float, slope: float, top: float | None) -> None:
        side = round(TILE * self.unit)
        self._unbounded(patchwork(self.texture_rng(), (side, side), colour, self.unit), nearness, slope, top)

    def _unbounded(self, texture: Array, nearness: float, slope: float, top: float | None) -> None:
        side = len(texture)
        maps = self._maps((side, side), np.zeros((self.frames, 2)), 0.0, nearness, slope)
        top_row = None if top is None else top * self.unit + (side - 1) / 2
        self.placed.append((1.0, Surface(BACKGROUND, texture, None, top_row, maps)))

    def _bounded(
        self,
        label: int,
        opacity: Array,
        colour: tuple[float, ...],
        centre: Array,
        nearness: float,
        rotation: Array | float = 0.0,
    ) -> None:
        height, width = opacity.shape
        texture = patchwork(self.texture_rng(), (height, width), colour, self.unit * 0.6, contrast=30.0)
        self._piece(label, (texture, opacity), centre, nearness, rotation)

    def _piece(
        self, label: int, piece: Piece, centre: Array, nearness: float, rotation: Array | float = 0.0
    ) -> None:
        texture, opacity = piece
        height, width = opacity.shape
        maps = self._maps((height, width), centre, rotation, nearness, 0.0)
        self.placed.append((nearness, Surface(label, texture, opacity, None, maps)))

    def _maps(
        self, shape: tuple[int, int], centre: Array, rotation: Array | float, nearness: float, slope: float
    ) -> Array:
        """Map texture px to image px: place in the world, shift by the camera with parallax, roll, zoom."""
        to_units = np.diag([1 / self.unit, 1 / self.unit, 1.0])
        to_units[:2, 2] = -(shape[1] - 1) / 2 / self.unit, -(shape[0] - 1) / 2 / self.unit
        place = _similarity(np.broadcast_to(rotation, (self.frames,)), np.ones(self.frames), centre)
        parallax = np.tile(np.eye(3), (self.frames, 1, 1))
        for axis, camera in enumerate((self.x, self.y)):
            parallax[:, axis, 1] -= slope * camera
            parallax[:, axis, 2] -= nearness * camera
        view = _similarity(self.roll, self.zoom, np.zeros((self.frames, 2)))
        to_pixels = np.diag([self.unit, self.unit, 1.0])
        to_pixels[:2, 2] = (self.width - 1) / 2, (self.height - 1) / 2
        return (to_pixels @ view @ parallax @ place @ to_units)[:, :2]


def _similarity(angle: Array, scale: Array, shift: Array) -> Array:
    """Return (frames, 3, 3): rotation and scale about the origin, then shift."""
    matrices = np.tile(np.eye(3), (len(shift), 1, 1))
    matrices[:, 0, 0] = matrices[:, 1, 1] = scale * np.cos(angle)
    matrices[:, 1, 0] = scale * np.sin(angle)
    matrices[:, 0, 1] = -matrices[:, 1, 0]
    matrices[:, :2, 2] = shift
    return matrices


def _object_colour(rng: np.random.Generator) -> tuple[float, ...]:
    """Return a colour that stands out from the background only moderately."""
    return tuple(rng.uniform(60, 200, 3).tolist())
