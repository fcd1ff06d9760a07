"""What a subtractor may be given: checked before its first frame, where a mistake is made."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from os import PathLike
from typing import Any

import numpy as np

from mlbs_actors.appearance.own_appearance import is_appearance
from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError, SourceError
from mlbs_actors.stored_motion import StoredMotion
from mlbs_actors.wording import described

__all__ = ["check_appearance", "check_config", "check_functions", "check_ignored", "check_video"]


def check_config(config: object) -> None:
    """Raise ConfigError if it is neither a Config nor None."""
    if config is not None and not isinstance(config, Config):
        raise ConfigError(f"Give a Config, not {config!r}; load_config reads one from a file.")


def check_functions(inspector: object, flow: object, tracks: object) -> None:
    """Raise ConfigError if one of them cannot be called."""
    expected = {
        "inspector": (inspector, "a function of a FrameInspection"),
        "flow": (flow, "a function of two frames"),
        "tracks": (tracks, "a function of two frames and the points of the first"),
    }
    for name, (given, wanted) in expected.items():
        if given is None or callable(given):
            continue
        advice = "" if name == "inspector" else f"; StoredMotion(...).{name} reads it from a folder"
        if isinstance(given, StoredMotion):
            advice = f"; give its {name}, stored.{name}"
        raise ConfigError(f"{name} must be {wanted}, not {_shown(given)}{advice}.")


def check_ignored(ignored: object) -> None:
    """Raise ConfigError if it is neither a mask nor None."""
    if ignored is None:
        return
    if not isinstance(ignored, np.ndarray):
        path = repr(str(ignored)) if isinstance(ignored, (str, PathLike)) else '"mask.png"'
        raise ConfigError(
            f"ignored must be a (height, width) mask of bool, not {_shown(ignored)}; "
            f"cv2.imread({path}, cv2.IMREAD_GRAYSCALE) != 0 makes one of a picture."
        )
    if ignored.ndim != 2 or ignored.dtype != bool or not ignored.size:
        raise ConfigError(
            f"ignored must be a (height, width) mask of bool, not {ignored.shape} {ignored.dtype}; "
            "mask != 0 makes one of a picture."
        )


def check_appearance(appearance: Any) -> None:
    """Raise ConfigError if no model of a layer can be made by it."""
    if appearance is None:
        return
    wanted = "appearance must be a class that is made with a layer's kind, such as Histogram(kind)"
    if not callable(appearance):
        raise ConfigError(f"{wanted}, not {_shown(appearance)}; give the class itself.")
    if isinstance(appearance, type) and not is_appearance(appearance):
        raise ConfigError(f"{appearance.__name__} cannot be an appearance: it needs update and log_density.")
    try:
        signature = inspect.signature(appearance)
    except (TypeError, ValueError):  # of a callable that does not tell
        return
    try:
        signature.bind("object")
    except TypeError as error:
        raise ConfigError(f"{wanted}; with the kind as its only argument there is: {error}.") from None


def check_video(video: object) -> None:
    """Raise SourceError if it is neither a path nor frames."""
    if isinstance(video, (str, PathLike)):
        return
    if isinstance(video, int):
        raise SourceError(
            f"{video} is no file: give the frames of a camera, one after the other, as "
            f"cv2.VideoCapture({video}) reads them."
        )
    if isinstance(video, np.ndarray) and video.ndim != 4:
        raise SourceError(
            f"A video is frames, not one array {described(video)}: give a list of frames, or this frame to "
            "apply."
        )
    if not isinstance(video, Iterable) and not hasattr(video, "__getitem__"):
        raise SourceError(f"A video is a path or frames, not {described(video)}.")


def _shown(given: object) -> str:
    return repr(given) if isinstance(given, (str, int, float, PathLike)) else described(given)
