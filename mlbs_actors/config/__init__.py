"""Every parameter of the engine: frozen, validated, with its unit, meaning and paper section.

One set serves all videos. Lengths are stated in px of a 640×480 frame and scale with the frame's side
(:func:`length_scale`), so that the same object is treated alike at any resolution; in large frames they grow
less, so that smaller things are seen in them.

``tracking``, ``clustering``, ``layer`` and ``segmentation`` have the sections, ``config`` all of them and how
they are read, ``parameters`` what they have in common; ``scale`` has how lengths grow.
"""

from mlbs_actors.config.clustering import AffinityConfig, IdentityConfig, LayersConfig
from mlbs_actors.config.config import Config, load_config, with_overrides
from mlbs_actors.config.layer import AppearanceConfig, MotionConfig, PosteriorConfig
from mlbs_actors.config.scale import detail, length_scale
from mlbs_actors.config.segmentation import SegmentationConfig
from mlbs_actors.config.tracking import FlowConfig, GridConfig, TrajectoriesConfig

__all__ = [
    "AffinityConfig",
    "AppearanceConfig",
    "Config",
    "FlowConfig",
    "GridConfig",
    "IdentityConfig",
    "LayersConfig",
    "MotionConfig",
    "PosteriorConfig",
    "SegmentationConfig",
    "TrajectoriesConfig",
    "detail",
    "length_scale",
    "load_config",
    "with_overrides",
]
