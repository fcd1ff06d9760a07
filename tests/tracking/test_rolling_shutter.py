"""The rows of a picture that swing with a trembling camera are told from what moves in it."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.config import TrajectoriesConfig
from mlbs_actors.geometry.homography import homography_motion
from mlbs_actors.messages import Array
from mlbs_actors.tracking.camera import camera_evidence, camera_homography, explained_share
from mlbs_actors.tracking.rolling_shutter import Swing, swing_of_rows

CONFIG = TrajectoriesConfig()
HEIGHT, WIDTH = 480, 640
WAVE = Swing(1.5, np.array([3.0, 0.4]), np.array([2.0, -0.3]), HEIGHT)


def seen(swing: Swing | None, moving: float = 0.0) -> tuple[Array, Array]:
    """Background trajectories and their motions, of which a share moves by itself."""
    generator = np.random.default_rng(0)
    positions = (generator.uniform(size=(400, 2)) * (WIDTH, HEIGHT)).astype(np.float32)
    camera = np.array([[1.01, 0.002, -4.0], [-0.001, 1.005, 2.0], [1e-6, 2e-6, 1.0]])
    motions = homography_motion(camera, positions) + generator.normal(0, 0.1, (400, 2))
    if swing is not None:
        motions += swing.at(positions[:, 1])
    motions[: int(400 * moving)] += (9.0, 1.0)
    return positions, motions.astype(np.float32)


def found(positions: Array, motions: Array) -> tuple[Swing, Array] | None:
    camera = camera_homography(positions, motions, 1.0, CONFIG)
    explained = explained_share(camera, positions, motions, 1.0, CONFIG)
    return swing_of_rows(positions, motions, explained, HEIGHT, 1.0, CONFIG)


@pytest.mark.parametrize("moving", [0.0, 0.08])
@pytest.mark.parametrize("waves", [0.8, 1.5, 2.6, 4.4])
def test_a_wave_of_the_rows_is_found_beside_the_camera_s_own_motion(waves: float, moving: float) -> None:
    wave = Swing(waves, WAVE.sine, WAVE.cosine, HEIGHT)
    positions, motions = seen(wave, moving)
    result = found(positions, motions)
    assert result is not None
    swing, camera = result
    still = slice(int(400 * moving), None)
    error = motions - homography_motion(camera, positions) - swing.at(positions[:, 1])
    assert np.median(np.hypot(*error[still].T)) < 0.4


def test_what_a_homography_explains_does_not_swing() -> None:
    assert found(*seen(None)) is None
    assert found(*seen(None, moving=0.3)) is None


def test_rows_that_move_at_random_do_not_swing() -> None:
    positions, motions = seen(None)
    rows = np.random.default_rng(1).normal(0, 5, (16, 2))
    assert found(positions, motions + rows[(positions[:, 1] // 30).astype(int)].astype(np.float32)) is None


def test_of_a_few_trajectories_no_wave_is_told() -> None:
    positions, motions = seen(WAVE)
    assert found(positions[:10], motions[:10]) is None


def test_a_picture_that_swings_is_explained_by_its_rows() -> None:
    generator = np.random.default_rng(2)
    before = generator.integers(0, 255, (60, 80)).astype(np.uint8)
    rows = np.where(np.arange(60)[:, None] < 30, 4.0, -4.0) * np.array([[1.0, 0.0]])
    now = np.stack([np.roll(line, -int(by)) for line, by in zip(before, rows[:, 0], strict=True)])
    flow = np.zeros((60, 80, 2), np.float32)

    def unexplained(by: Array | None) -> float:
        evidence = camera_evidence(before, now, np.eye(3), flow, 1, CONFIG, by)
        return float(np.median(evidence.difference[:, 8:-8]))

    assert unexplained(None) > 20
    assert unexplained(rows.astype(np.float32)) == 0
