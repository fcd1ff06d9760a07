"""Online, training-free segmentation of every independently moving object in moving-camera video.

``MultilayerSubtractor`` segments one video or stream, frame by frame; this is all that a program needs:

=================================  ===================================================================
``MultilayerSubtractor``           takes frames, returns results
``Result``                         of one frame: label map, objects, which of them come and go
``Segmentation``                   what a result is made of: label map and objects
``LayerSummary``                   one object in one frame
``Region``, ``Boxes``              its bounding box, and those of all objects in a frame
``Config``, ``load_config``        all parameters, and how to change some of them
``MlbsError``                      base of all errors: ``ConfigError``, ``FrameError``, ``LayerError``,
                                   ``MissingPackageError``, ``SinkError``, ``SolverError``,
                                   ``SourceError``
=================================  ===================================================================

``docs/python_api.md`` shows their use by example. All other modules are the engine's parts.
"""

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
    MissingPackageError,
    MlbsError,
    SinkError,
    SolverError,
    SourceError,
)
from mlbs_actors.messages import Boxes, LayerSummary, Region, Segmentation
from mlbs_actors.result import Result

if TYPE_CHECKING:
    from mlbs_actors.subtractor import MultilayerSubtractor

__version__ = "0.1.0"

if not (4, 10) <= tuple(map(int, cv2.__version__.split(".")[:2])) < (6, 0):
    raise ImportError(f"mlbs_actors needs OpenCV 4.10 to 5, not {cv2.__version__}; install one of those.")

__all__ = [
    "Boxes",
    "Config",
    "ConfigError",
    "FrameError",
    "LayerError",
    "LayerSummary",
    "MissingPackageError",
    "MlbsError",
    "MultilayerSubtractor",
    "Region",
    "Result",
    "Segmentation",
    "SinkError",
    "SolverError",
    "SourceError",
    "load_config",
]


def __dir__() -> list[str]:
    return [*__all__, "__doc__", "__file__", "__name__", "__path__", "__version__"]


if not TYPE_CHECKING:  # hidden from type checkers, which would accept every name

    def __getattr__(name: str) -> object:
        """Import the engine on demand: most processes of a stream need a part of it or none."""
        if name == "MultilayerSubtractor":
            from mlbs_actors.subtractor import MultilayerSubtractor

            return MultilayerSubtractor
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
