"""``run.json``: what a run was asked for, and what its results depend on."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from mlbs_actors.config import Config
from orchestrator.credentials import mask
from orchestrator.run.listed_stream import ListedStream
from orchestrator.run.versions import installed_versions

__all__ = ["describe_run"]

#: Keys that stay as they were when a run was begun.
_LASTING = ("started", "versions", "machine")


def describe_run(
    streams: Sequence[ListedStream],
    config: Config,
    asked: Mapping[str, object],
    command: Sequence[str] = (),
    before: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return its content: everything that the results depend on, without credentials.

    Parameters
    ----------
    streams : sequence of ListedStream
    config : Config
    asked : mapping of str to object
        The options of the command, from :func:`orchestrator.options.recorded`.
    command : sequence of str
        Starts the same run.
    before : mapping, optional
        The content before, whose sources stay, as those of streams that are not listed any more are needed to
        export their results; and with it what is said of the run's beginning.
    """
    parameters = config.model_dump(mode="json")
    earlier = {} if before is None else dict(before)
    sources = {**earlier.get("sources", {}), **{stream.name: str(stream.source) for stream in streams}}
    description = {
        "started": datetime.now(timezone.utc).isoformat(timespec="milliseconds"),
        "config": parameters,
        "sources": sources,
        "settings": earlier.get("settings", {}),
        **asked,
        "command": [mask(word) for word in command],
        "hashes": {"config": _digest(parameters), "sources": _digest(sources)},
        "versions": installed_versions(),
        "machine": {"cpu": _cpu(), "system": platform.platform()},
    }
    return description | {key: earlier[key] for key in _LASTING if key in earlier}


def _digest(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.machine()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return mask(next(names, platform.machine()))
