"""What tells whether a picture goes on, and in which light, against the same by plain loops."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mlbs_actors import Config
from mlbs_actors.flow.consistency import DenseFlow, checked_flow
from mlbs_actors.footage import continuity, light
from mlbs_actors.footage.continuity import Likeness, rows_astray
from mlbs_actors.footage.light import light_change, matched_places
from mlbs_actors.messages import Array

SIDE = 2


def smooth_flow(shape: tuple[int, int], seed: int) -> DenseFlow:
    """A pan that bends, px, with noise and a torn band; out of the picture on one side."""
    rng, (height, width) = np.random.default_rng(seed), shape
    y, x = np.mgrid[0:height, 0:width]
    bend = np.stack([4.0 + 3.0 * np.sin(y / 9.0), 2.0 * np.cos(x / 11.0)], axis=-1)
    forward = (bend + rng.normal(0, 0.1, bend.shape)).astype(np.float32)
    backward = (-bend + rng.normal(0, 0.1, bend.shape)).astype(np.float32)
    backward[height // 3 : height // 2] += 15.0
    return checked_flow(forward, backward, SIDE, Config().trajectories)


def textured(shape: tuple[int, int], seed: int) -> Array:
    noise = np.random.default_rng(seed).normal(0, 1, shape)
    level = cv2.GaussianBlur(noise, (0, 0), 2.0)
    contrast = np.full(shape[1], 200.0)
    contrast[: shape[1] // 4] = 10.0  # next to nothing to see there
    return np.asarray(np.clip(128 + contrast * level, 0, 255), np.uint8)


@pytest.mark.parametrize("shape", [(40, 53), (31, 64), (9, 9)])
def test_windows_are_correlated_along_the_flow(shape: tuple[int, int]) -> None:
    flow, before, gray = smooth_flow(shape, 0), textured(shape, 1), textured(shape, 2)
    found = Likeness.along(flow, before, gray)
    rows = range(0, shape[0], continuity.WINDOW_STEP)
    columns = range(0, shape[1], continuity.WINDOW_STEP)
    there = np.empty((len(rows), len(columns), 2), np.float32)
    for row, y in enumerate(rows):
        for column, x in enumerate(columns):
            there[row, column] = np.array([x, y]) + flow.backward[y, x] / SIDE
    places = there[..., 0], there[..., 1]
    old = cv2.remap(before, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    new, reach = gray[:: continuity.WINDOW_STEP, :: continuity.WINDOW_STEP], continuity.WINDOW_SIDE // 2
    padded = [np.pad(one.astype(np.float64), reach, mode="reflect") for one in (old, new)]
    for row in range(len(rows)):
        for column in range(len(columns)):
            one, other = (
                image[row : row + 2 * reach + 1, column : column + 2 * reach + 1].ravel() for image in padded
            )
            x, y = there[row, column]
            if not (0 <= x <= shape[1] - 1 and 0 <= y <= shape[0] - 1):
                assert found.correlation[row, column] == found.variance[row, column] == 0
                continue
            # A place may be rounded elsewhere, and with it a level.
            largest = max(one.var(), other.var())
            assert found.variance[row, column] == pytest.approx(largest, rel=0.02, abs=0.1)
            if min(one.var(), other.var()) > continuity.TEXTURE:
                expected = np.corrcoef(one, other)[0, 1]
                assert found.correlation[row, column] == pytest.approx(expected, abs=0.01)


def test_rows_are_astray_by_the_share_of_cells_that_the_camera_does_not_lead_there() -> None:
    flow, scale = smooth_flow((48, 64), 3), 1.2
    camera = np.array([[1.01, 0.02, -5.0], [-0.01, 0.99, 1.0], [1e-5, 2e-5, 1.0]])
    expected = []
    for y in range(0, 48, continuity.STEP):
        astray = []
        for x in range(0, 64, continuity.STEP):
            place = np.array([x * SIDE, y * SIDE, 1.0])
            along, down, depth = camera @ place
            off = np.abs(flow.backward[y, x] - (np.array([along, down]) / depth - place[:2])).max()
            astray.append(off > continuity.ASTRAY_PX * scale or not flow.backward_reliable[y, x])
        expected.append(np.mean(astray))
    found = rows_astray(flow, camera, scale)
    assert 0 < found.mean() < 1
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_places_are_matched_where_the_flow_is_sure_and_ends_in_the_picture() -> None:
    flow = smooth_flow((50, 61), 4)
    reliable, expected = flow.forward_reliable(), []
    for y in range(0, 50, light.STEP):
        for x in range(0, 61, light.STEP):
            to_x, to_y = np.array([x, y]) + np.rint(flow.forward[y, x] / np.float32(SIDE)).astype(int)
            if reliable[y, x] and 0 <= to_x < 61 and 0 <= to_y < 50:
                expected.append((61 * y + x, 61 * to_y + to_x))
    assert 10 < len(expected) < 90
    assert list(zip(*(one.tolist() for one in matched_places(flow)), strict=True)) == expected


def plain_light_change(before: Array, after: Array) -> Array:
    """The rule of the module, with medians and quantiles of NumPy."""

    def table(changes: list[tuple[float, float]]) -> Array:
        levels = np.arange(256.0)
        return np.array([np.clip(np.rint(gain * levels + offset), 0, 255) for gain, offset in changes])

    def left(changes: Array) -> float:
        seen = np.stack([change[one] for change, one in zip(changes, before.T, strict=True)], axis=1)
        return float(np.median(np.abs(seen - after), axis=0).mean())

    gains = []
    for old, new in zip(before.astype(float).T, after.astype(float).T, strict=True):
        gain = 1.0
        for _ in range(2):
            mean = np.sqrt(old * new)
            whole = mean > light.DARKEST
            whole &= mean * np.sqrt(max(gain, 1 / gain)) < light.BRIGHTEST - light.MARGIN
            if whole.sum() >= light.LEAST_PLACES:
                gain = float(np.median((new / np.maximum(old, 1))[whole]))
        gains.append(gain)
    change = table([(1.0, 0.0)] * len(gains))
    changed = np.abs(np.log(gains)).max() >= light.LEAST_GAIN
    if changed:
        change = table([(gain, 0.0) for gain in gains])
    if left(change) >= light.LEAST_CHANGE:
        fits = []
        for old, new in zip(np.sort(before, axis=0).T, np.sort(after, axis=0).T, strict=True):
            places = np.rint(light.QUANTILES * (len(old) - 1)).astype(int)
            one, other = old[places].astype(float), new[places].astype(float)
            whole = (np.minimum(one, other) > light.DARKEST) & (np.maximum(one, other) < light.BRIGHTEST)
            gain, offset = 1.0, float(np.median(other - one))
            if whole.sum() >= light.LEAST_QUANTILES:
                one, other = one[whole], other[whole]
                offset = float(np.median(other - one))
                if min(one.std(), other.std()) >= light.LEAST_SPREAD:
                    gain = float(other.std() / one.std())
                    offset = float(other.mean() - gain * one.mean())
            fits.append((gain, offset))
        if left(table(fits)) <= light.MOST_LEFT * left(change):
            return table(fits)
    return change if changed else np.zeros((0, 256))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (1.03, 0.0), (0.7, 0.0), (1.0, 25.0), (1.4, -20.0)])
@pytest.mark.parametrize("count", [63, 64, 801])
def test_the_change_of_light_is_that_of_plain_medians_and_quantiles(
    channels: int, gain: float, offset: float, count: int
) -> None:
    rng = np.random.default_rng(count)
    before = np.clip(rng.normal(120, 50, (count, channels)), 0, 255).astype(np.uint8)
    noisy = gain * before + offset + rng.normal(0, 3, before.shape)
    after = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    expected = plain_light_change(before, after) if count >= light.LEAST_PLACES else np.zeros((0, 256))
    np.testing.assert_array_equal(light_change(before, after), expected)
