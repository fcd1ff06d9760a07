"""Whether a stream of today is the one of a record: a file is its path, a camera is its name."""

from __future__ import annotations

from pathlib import Path

from mlbs_actors.errors import ConfigError
from orchestrator.run.listed_stream import ListedStream
from orchestrator.sources.address import parse_address

__all__ = ["goes_on", "is_camera", "other_source"]


def is_camera(source: str) -> bool:
    """Whether a source, as a run's description has it, is a camera."""
    try:
        return parse_address(source, Path("/")).live
    except ConfigError:  # of an earlier version
        return False


def goes_on(recorded: str, now: str) -> bool:
    """Whether a stream can go on with the record of a source: cameras may be at another address."""
    return recorded == now or (is_camera(recorded) and is_camera(now))


def other_source(stream: ListedStream, recorded: str) -> str | None:
    """Say why a stream cannot go on with the record of a source; None if it can."""
    if goes_on(recorded, str(stream.source)):
        return None
    return (
        f"the name {stream.name!r} stands for {recorded} in this run, and only a camera can be at another "
        "address; choose another one"
    )
