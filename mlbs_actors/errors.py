"""Every error this package raises on purpose.

::

    MlbsError
    ├── ConfigError      a parameter, stream list or command line that cannot be used
    ├── SourceError      a source that cannot be opened or decoded
    ├── FrameError       a frame that the engine cannot take (type, size, order)
    ├── SolverError      a numerical solver that failed its own residual check
    ├── LayerError       a layer process that failed or was lost
    └── SinkError        results that cannot be written

Each is raised with exactly one message, a sentence that says what to do, so that it crosses process
boundaries intact.
"""

from __future__ import annotations

__all__ = ["ConfigError", "FrameError", "LayerError", "MlbsError", "SinkError", "SolverError", "SourceError"]


class MlbsError(Exception):
    """Base of every deliberate error; catch it to catch them all."""


class ConfigError(MlbsError):
    """A parameter, stream list or command line cannot be used."""


class SourceError(MlbsError):
    """A source cannot be opened or decoded."""


class FrameError(MlbsError):
    """A frame has a type, size or index that the engine cannot take."""


class SolverError(MlbsError):
    """A numerical solver failed its own residual check."""


class LayerError(MlbsError):
    """A layer process failed or was lost."""


class SinkError(MlbsError):
    """Results cannot be written."""
