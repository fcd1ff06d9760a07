"""What a subtractor cannot be given is told in a sentence that says what to give, before the first frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mlbs_actors import ConfigError, LayerError, MultilayerSubtractor, SourceError, StoredMotion
from mlbs_actors.appearance.own_appearance import made_by
from mlbs_actors.messages import Array


class Model:
    """An appearance that knows nothing."""

    def __init__(self, kind: str) -> None:
        pass

    def update(self, colours: Array, won: Array, region: object) -> None:
        pass

    def log_density(self, colours: Array, region: object, motion: Array) -> Array:
        return np.full(colours.shape[:2], np.nan)


class WithoutKind(Model):
    def __init__(self) -> None:
        pass


class WithoutDensity:
    def __init__(self, kind: str) -> None:
        pass

    def update(self, colours: Array, won: Array, region: object) -> None:
        pass


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"flow": "x"}, r"flow must be a function of two frames, not 'x'; StoredMotion\(\.\.\.\)\.flow"),
        ({"flow": Path("flow")}, r"StoredMotion\(\.\.\.\)\.flow reads it from a folder"),
        ({"tracks": 3}, "tracks must be a function of two frames and the points of the first, not 3"),
        ({"inspector": "x"}, r"inspector must be a function of a FrameInspection, not 'x'\."),
        ({"appearance": 3}, "appearance must be a class .*, not 3; give the class itself"),
        ({"appearance": Model("object")}, "not a Model; give the class itself"),
        ({"appearance": WithoutKind}, "with the kind as its only argument there is: too many positional"),
        ({"appearance": WithoutDensity}, "WithoutDensity cannot be an appearance: .* log_density"),
        ({"ignored": "logo.png"}, r"cv2\.imread\('logo\.png', cv2\.IMREAD_GRAYSCALE\) != 0 makes one"),
        ({"ignored": [[True]]}, "ignored must be a .* mask of bool, not a list of 1"),
        ({"ignored": np.zeros((2, 2), np.uint8)}, r"not \(2, 2\) uint8; mask != 0"),
    ],
)
def test_what_cannot_be_used_is_refused_before_the_first_frame(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        MultilayerSubtractor(**given)


def test_stored_motion_given_whole_is_told_which_part_to_give(tmp_path: Path) -> None:
    stored: Any = StoredMotion("clip", tmp_path, here=False)
    with pytest.raises(ConfigError, match=r"give its flow, stored\.flow\."):
        MultilayerSubtractor(flow=stored)


@pytest.mark.parametrize("appearance", [None, Model, lambda kind: Model(kind)])
def test_whatever_makes_a_model_of_a_kind_can_be_given(appearance: Any) -> None:
    MultilayerSubtractor(appearance=appearance)


def test_a_function_that_makes_no_model_is_told() -> None:
    with pytest.raises(LayerError, match=r"appearance\('object'\) made None; it must make an object with"):
        made_by(lambda kind: None, "object")  # type: ignore[arg-type, return-value]


def test_what_is_no_video_is_told_with_what_to_give_instead(tmp_path: Path) -> None:
    wrong: dict[str, Any] = {
        r"give the frames of a camera, .*cv2\.VideoCapture\(0\)": 0,
        r"is a folder; give its pictures as frames: \(cv2\.imread": tmp_path,
        r"not one array \(4, 6, 3\) uint8: give a list of frames, or this frame to apply": np.zeros(
            (4, 6, 3), np.uint8
        ),
        "A video is a path or frames, not None": None,
        "There is no video": tmp_path / "a.mp4",
    }
    for sentence, video in wrong.items():
        with pytest.raises(SourceError, match=sentence):
            next(MultilayerSubtractor().segment(video))
