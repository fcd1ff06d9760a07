"""The check of a node of a cluster before it gets streams; it runs there."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from mlbs_actors.actors.node.memory import node_memory
from mlbs_actors.errors import ConfigError
from orchestrator.run.admission import places
from orchestrator.run.need import Need
from orchestrator.run.versions import installed_versions

__all__ = ["node_places"]


def node_places(folder: Path, versions: Mapping[str, str | None], need: Need, cpus: float) -> int:
    """Return how many streams this node can hold.

    Parameters
    ----------
    folder : Path
        The run's, which all nodes must see.
    versions : mapping of str to str
        Those of the command: with others, label maps would depend on the node.
    need : Need
        Of each stream.
    cpus : float
        Of this node, as Ray counts them.

    Raises
    ------
    ConfigError
        If it cannot be used.
    """
    here = installed_versions()
    others = [
        f"{name} {here.get(name)} instead of {version}"
        for name, version in versions.items()
        if here.get(name) != version
    ]
    if others:
        raise ConfigError(
            f"it has {', '.join(others)}; install the same versions there as on the machine of the command"
        )
    if not (folder / "run.json").exists():
        raise ConfigError(
            f"the output folder {folder} is not there; put it on a file system that all nodes share"
        )
    return places(node_memory(), cpus, need)
