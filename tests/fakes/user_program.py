"""A program as users write it; its types are checked as theirs are."""

from __future__ import annotations

import pickle
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from mlbs_actors import Boxes, Config, MlbsError, MultilayerSubtractor, Result, load_config


def areas_of_video(path: Path) -> dict[int, list[int]]:
    """Areas of each object in a video, px."""
    areas: dict[int, list[int]] = {}
    try:
        for frame, result in MultilayerSubtractor().segment(path):
            assert frame.shape[:2] == result.labels.shape
            for layer in result.layers:
                areas.setdefault(layer.layer, []).append(layer.area)
    except MlbsError as error:
        print(error)
    return areas


def results_of(frames: Iterable[npt.NDArray[np.uint8]], config: Config | None = None) -> list[Result]:
    """Results of frames, with their numbers as tags; half of them from a copy."""
    subtractor = MultilayerSubtractor(config or load_config(None, ["layers.lookahead=2"]), flow=None)
    results: list[Result] = []
    for number, frame in enumerate(frames):
        results += subtractor.apply(frame, tag=number)
        if number == 3:
            subtractor = pickle.loads(pickle.dumps(subtractor))
    return results + subtractor.flush()


def largest_box(result: Result) -> tuple[int, tuple[int, ...]] | None:
    """Id and box of the largest object."""
    boxes: Boxes = result.boxes()
    if not len(boxes.ids):
        return None
    mask: npt.NDArray[np.bool_] = np.stack([result.mask(int(one)) for one in boxes.ids])
    largest = int(mask.sum(axis=(1, 2)).argmax())
    return int(boxes.ids[largest]), tuple(map(int, boxes.xyxy[largest]))


def births(results: Iterable[Result]) -> dict[int, int]:
    """Tag of the frame in which each id is born."""
    return {layer: result.tag for result in results for layer in (*result.born, *result.ended)}
