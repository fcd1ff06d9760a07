"""The refinement of a flow, against plain loops and OpenCV's."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from opencv_sampling import exact_opencv

from mlbs_actors.flow.variational_refinement import refine_flow
from mlbs_actors.messages import Array, Region

MARGIN, OMEGA = 16, 1.6


def textures(shape: tuple[int, int], seed: int) -> tuple[Array, Array]:
    """A frame and the next one, (h, w) uint8: smooth noise, moved by (1.4, −0.7) px."""
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.normal(size=(shape[0] + 20, shape[1] + 20)), (0, 0), 2.0)
    first = np.clip(128 + 250 * noise, 0, 255).astype(np.uint8)
    second = cv2.warpAffine(first, np.array([[1, 0, 1.4], [0, 1, -0.7]]), first.shape[::-1])
    return first[10:-10, 10:-10].copy(), np.asarray(second)[10:-10, 10:-10].copy()


def refined(source: Array, target: Array, part: Region, flow: Array, sweeps: int, steps: int = 1) -> Array:
    around = cv2.copyMakeBorder(
        target.astype(np.float32), MARGIN, MARGIN, MARGIN, MARGIN, cv2.BORDER_REPLICATE
    )
    flow = flow.copy()
    for _ in range(steps):
        refine_flow(source, around, (part.x, part.y), flow, MARGIN, sweeps)
    return flow


def refined_by_loops(source: Array, target: Array, part: Region, flow: Array, sweeps: int) -> Array:
    """The same in double precision: whole maps, the derivatives by slices, the solver pixel by pixel."""
    y, x = np.mgrid[part.slices].astype(np.float64)
    u, v = flow.astype(np.float64)
    there_x, there_y = np.clip(x + u, 0, source.shape[1] - 1), np.clip(y + v, 0, source.shape[0] - 1)
    left = np.minimum(there_x.astype(int), source.shape[1] - 2)
    top = np.minimum(there_y.astype(int), source.shape[0] - 2)
    across, down = there_x - left, there_y - top
    shown = target.astype(np.float64)
    warped = (1 - down) * ((1 - across) * shown[top, left] + across * shown[top, left + 1])
    warped += down * ((1 - across) * shown[top + 1, left] + across * shown[top + 1, left + 1])
    own = source[part.slices].astype(np.float64)
    mean, it = (own + warped) / 2, warped - own

    def by_x(image: Array) -> Array:
        padded = np.pad(image, 1, mode="edge")
        return np.asarray(padded[1:-1, 2:] - padded[1:-1, :-2])

    def by_y(image: Array) -> Array:
        return by_x(image.T).T

    ix, iy, ixt, iyt = by_x(mean), by_y(mean), by_x(it), by_y(it)
    ixx, ixy, iyy = by_x(ix), by_y(ix), by_y(iy)
    norm, norm_x, norm_y = ix**2 + iy**2 + 0.01, ixx**2 + ixy**2 + 0.01, ixy**2 + iyy**2 + 0.01
    colour = 2.5 / np.sqrt(it**2 / norm + 1e-6) / norm
    slopes = 5.0 / np.sqrt(ixt**2 / norm_x + iyt**2 / norm_y + 1e-6)
    a11 = colour * ix**2 + slopes * (ixx**2 / norm_x + ixy**2 / norm_y) + 0.01
    a22 = colour * iy**2 + slopes * (ixy**2 / norm_x + iyy**2 / norm_y) + 0.01
    a12 = colour * ix * iy + slopes * ixy * (ixx / norm_x + iyy / norm_y)
    b1 = -colour * ix * it - slopes * (ixx * ixt / norm_x + ixy * iyt / norm_y)
    b2 = -colour * iy * it - slopes * (ixy * ixt / norm_x + iyy * iyt / norm_y)
    height, width = u.shape
    steps = [np.diff(known, axis=axis, append=known[:, -1:] if axis else known[-1:]) ** 2
             for known in (u, v) for axis in (0, 1)]  # fmt: skip
    bond = 10.0 / np.sqrt(sum(steps) + 1e-6)
    change = np.zeros((2, height, width))
    for half in range(2 * sweeps):
        for j in range(height):
            for i in range(width):
                if (i + j + half) % 2:
                    continue
                bonds = [
                    (b, n, m)
                    for b, n, m in (
                        (bond[j, i], j, i + 1), (bond[j, i - 1], j, i - 1),
                        (bond[j, i], j + 1, i), (bond[j - 1, i], j - 1, i),
                    )
                    if 0 <= n < height and 0 <= m < width
                ]  # fmt: skip
                for one, (a, b) in enumerate(((a11, b1), (a22, b2))):
                    known = (u, v)[one]
                    pull = b[j, i] - a12[j, i] * change[1 - one, j, i]
                    for weight, n, m in bonds:
                        pull += weight * (change[one, n, m] + known[n, m] - known[j, i])
                    exact = pull / (a[j, i] + sum(weight for weight, _, _ in bonds))
                    change[one, j, i] += OMEGA * (exact - change[one, j, i])
    return np.stack([u, v]) + change


@pytest.mark.parametrize("sweeps", [1, 3, 5])
@pytest.mark.parametrize(
    "part",
    [
        Region(0, 0, 37, 26), Region(9, 5, 16, 8), Region(20, 10, 17, 16), Region(0, 3, 31, 9),
        Region(5, 0, 32, 9), Region(4, 17, 33, 9),
    ],
)  # fmt: skip
def test_a_step_is_that_of_plain_loops(part: Region, sweeps: int) -> None:
    source, target = textures((26, 37), sweeps)
    flow = np.random.default_rng(part.x).normal(0, 1.0, (2, part.height, part.width)).astype(np.float32)
    expected = refined_by_loops(source, target, part, flow, sweeps)
    assert np.abs(expected - flow).max() > 0.1
    assert np.allclose(refined(source, target, part, flow, sweeps), expected, atol=2e-3)


@exact_opencv
def test_a_step_in_a_whole_frame_is_opencv_s() -> None:
    source, target = textures((60, 90), 3)
    flow = np.random.default_rng(4).normal(0, 0.5, (2, 60, 90)).astype(np.float32)
    flow[0] += 1
    u, v = flow.copy()
    opencv = cv2.VariationalRefinement.create()
    opencv.setFixedPointIterations(1)
    opencv.setSorIterations(3)
    opencv.setAlpha(20.0)
    opencv.setGamma(10.0)
    opencv.setDelta(5.0)
    opencv.calcUV(source, target, u, v)
    assert np.allclose(refined(source, target, Region(0, 0, 90, 60), flow, 3), np.stack([u, v]), atol=1e-3)


def test_steps_bring_a_rough_flow_nearer_to_the_motion() -> None:
    source, target = textures((60, 90), 5)
    motion = np.array([1.4, -0.7], np.float32)[:, None, None]
    rough = motion + np.random.default_rng(7).normal(0, 0.3, (2, 60, 90)).astype(np.float32)
    errors = [
        np.abs(refined(source, target, Region(0, 0, 90, 60), rough, 3, steps) - motion)[:, 5:-5, 5:-5].mean()
        for steps in (0, 1, 5)
    ]
    assert errors[1] < 0.6 * errors[0]
    assert errors[2] < 0.3 * errors[0]


def test_flow_that_leads_out_of_the_frame_and_flat_frames_stay_finite() -> None:
    flat = np.full((20, 30), 90, np.uint8)
    far = np.full((2, 20, 30), 1e6, np.float32)
    far[1] *= -1
    for source, target in ((flat, flat), textures((20, 30), 6)):
        assert np.isfinite(refined(source, target, Region(0, 0, 30, 20), far, 3)).all()
    still = refined(flat, flat, Region(0, 0, 30, 20), np.zeros_like(far), 3)
    assert np.array_equal(still, np.zeros_like(far))
