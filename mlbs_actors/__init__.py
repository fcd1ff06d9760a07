"""Online, training-free segmentation of every independently moving object in moving-camera video."""

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
from mlbs_actors.subtractor import MultilayerSubtractor

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
