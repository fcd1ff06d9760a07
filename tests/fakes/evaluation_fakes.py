"""An engine that sees at once, and sequences that suit it: an object is what is bright."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.messages import Array, Segmentation


class BrightSubtractor:
    """Stands in for the engine: labels the bright pixels of each frame 1, or nothing if it is blind."""

    def __init__(self, blind: bool = False) -> None:
        self.blind = blind
        self.given = 0

    def apply(self, frame: Array) -> list[Segmentation]:
        labels = np.zeros(frame.shape[:2], np.uint16)
        if not self.blind:
            labels[frame[:, :, 0] > 128] = 1
        self.given += 1
        nothing = np.zeros(labels.shape, np.uint8)
        return [Segmentation(self.given - 1, labels, nothing, nothing.astype(np.int8), (), (0.0, 0.0), 0, {})]

    def flush(self) -> list[Segmentation]:
        return []


def write_bright_sequence(folder: Path, frames: int = 8) -> None:
    """Frames of 24×16 px with a bright box of 5×4 px that moves right, and their truth."""
    (folder / "frames").mkdir(parents=True)
    (folder / "gt").mkdir()
    for index in range(frames):
        truth = np.zeros((16, 24), np.uint8)
        truth[6:10, 4 + index : 9 + index] = 1
        cv2.imwrite(
            str(folder / "frames" / f"{index:05d}.png"), np.repeat(255 * truth[:, :, None], 3, axis=2)
        )
        cv2.imwrite(str(folder / "gt" / f"{index:05d}.png"), truth)
