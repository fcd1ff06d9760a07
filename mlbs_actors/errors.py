"""Every error this package raises on purpose.

::

    MlbsError
    ├── ConfigError      a parameter, stream list or command line that cannot be used
    ├── SourceError      a source that cannot be opened or decoded
    ├── FrameError       a frame that the engine cannot take (type, size, order)
    ├── SolverError      evidence that determines no motion field
    ├── LayerError       a layer that failed
    ├── ActorLostError   a process of a stream that was lost: the stream can go back to its last snapshot
    ├── NoPlaceError     no node can take a stream now: it waits
    ├── SnapshotError    a snapshot that is damaged or of another version
    ├── MissingPackageError  a package of an extra that is not installed; an ImportError, too
    └── SinkError        results that cannot be written

Each is raised with exactly one message, a sentence that says what to do, so that it crosses process
boundaries intact.
"""

from __future__ import annotations

__all__ = [
    "ActorLostError",
    "ConfigError",
    "FrameError",
    "LayerError",
    "MissingPackageError",
    "MlbsError",
    "NoPlaceError",
    "SinkError",
    "SnapshotError",
    "SolverError",
    "SourceError",
]


class MlbsError(Exception):
    """Base of every deliberate error; catch it to catch them all."""


class ConfigError(MlbsError):
    """A parameter, stream list or command line cannot be used."""


class SourceError(MlbsError):
    """A source cannot be opened or decoded."""


class FrameError(MlbsError):
    """A frame has a type, size or index that the engine cannot take."""


class SolverError(MlbsError):
    """A motion field cannot be solved: its evidence is not finite, or its terms are too far apart."""


class LayerError(MlbsError):
    """A layer failed."""


class ActorLostError(MlbsError):
    """A process of a stream was lost; the stream can go back to its last snapshot."""


class NoPlaceError(MlbsError):
    """No node of a cluster can take a stream now; it waits until one joins."""


class SnapshotError(MlbsError):
    """A snapshot is damaged or of another version."""


class MissingPackageError(MlbsError, ImportError):
    """A package that belongs to an extra is not installed."""


class SinkError(MlbsError):
    """Results cannot be written."""
