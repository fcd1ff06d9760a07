"""Online, training-free segmentation of every independently moving object in moving-camera video.

``MultilayerSubtractor`` segments one video or stream, frame by frame; this is all that a program needs:

=================================  ===================================================================
``MultilayerSubtractor``           takes frames, returns results
``Result``                         of one frame: label map, objects, which of them come and go
``Segmentation``                   what a result is made of: label map and objects
``LayerSummary``                   one object in one frame
``Region``, ``Boxes``              its bounding box, and those of all objects in a frame
``FrameInspection``                what an inspector sees of a frame: of each layer a
                                   ``LayerInspection``
``Config``, ``load_config``        all parameters, and how to change some of them
``Appearance``                     what an appearance model of your own has to have
``StoredMotion``                   flow and tracks that are read from files
``compile_kernels``                done beforehand, the first frame does not wait for it
``MlbsError``                      base of all errors: ``ConfigError``, ``FrameError``, ``LayerError``,
                                   ``MissingPackageError``, ``SinkError``, ``SolverError``,
                                   ``SourceError``
=================================  ===================================================================

Three modules are public, too: :mod:`mlbs_actors.pictures` draws label maps, :mod:`mlbs_actors.scenes` makes
videos with exact labels, :mod:`mlbs_actors.record` reads what a run has recorded. ``docs/python_api.md``
shows their use by example. All other modules are the engine's parts.
"""

import importlib
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
    from mlbs_actors.appearance.own_appearance import Appearance
    from mlbs_actors.inspection import FrameInspection, LayerInspection
    from mlbs_actors.stored_motion import StoredMotion
    from mlbs_actors.subtractor import MultilayerSubtractor
    from mlbs_actors.warm_up import compile_kernels

__version__ = "0.1.0"

if not (4, 10) <= tuple(map(int, cv2.__version__.split(".")[:2])) < (6, 0):
    raise ImportError(f"mlbs_actors needs OpenCV 4.10 to 5, not {cv2.__version__}; install one of those.")

__all__ = [
    "Appearance",
    "Boxes",
    "Config",
    "ConfigError",
    "FrameError",
    "FrameInspection",
    "LayerError",
    "LayerInspection",
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
    "StoredMotion",
    "compile_kernels",
    "load_config",
]


def __dir__() -> list[str]:
    return [*__all__, "__doc__", "__file__", "__name__", "__path__", "__version__"]


#: The modules of names that are imported when they are asked for: most processes of a stream need a part of
#: the engine or none.
_HOMES = {
    "Appearance": "appearance.own_appearance",
    "FrameInspection": "inspection",
    "LayerInspection": "inspection",
    "MultilayerSubtractor": "subtractor",
    "StoredMotion": "stored_motion",
    "compile_kernels": "warm_up",
}
_MODULES = ("pictures", "record", "scenes")

if not TYPE_CHECKING:  # hidden from type checkers, which would accept every name

    def __getattr__(name: str) -> object:
        if name in _MODULES:
            return importlib.import_module(f"{__name__}.{name}")
        if name in _HOMES:
            return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
