"""Online, training-free segmentation of every independently moving object in moving-camera video."""

from typing import TYPE_CHECKING

try:
    import cv2
except ImportError as error:
    raise ImportError(
        f"mlbs_actors needs OpenCV ({error}); unless you want another flavour of it: "
        "pip install opencv-python-headless"
    ) from None

from mlbs_actors.config import Config, load_config
from mlbs_actors.errors import (
    ConfigError,
    FrameError,
    LayerError,
    MlbsError,
    SinkError,
    SolverError,
    SourceError,
)
from mlbs_actors.messages import LayerSummary, Region, Segmentation

if TYPE_CHECKING:
    from mlbs_actors.subtractor import MultilayerSubtractor

__version__ = "0.1.0"

if not (4, 10) <= tuple(map(int, cv2.__version__.split(".")[:2])) < (6, 0):
    raise ImportError(f"mlbs_actors needs OpenCV 4.10 to 5, not {cv2.__version__}; install one of those.")

__all__ = [
    "Config",
    "ConfigError",
    "FrameError",
    "LayerError",
    "LayerSummary",
    "MlbsError",
    "MultilayerSubtractor",
    "Region",
    "Segmentation",
    "SinkError",
    "SolverError",
    "SourceError",
    "load_config",
]


if not TYPE_CHECKING:  # hidden from type checkers, which would accept every name

    def __getattr__(name: str) -> object:
        """Import the engine on demand: most processes of a stream need a part of it or none."""
        if name == "MultilayerSubtractor":
            from mlbs_actors.subtractor import MultilayerSubtractor

            return MultilayerSubtractor
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
