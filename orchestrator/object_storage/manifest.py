"""What a manifest says: of every file of a run, which bytes of which objects it is.

``manifests/000000000012.json`` is the twelfth *generation*. Nothing that is not named by the newest counts. A
manifest has what changed since the one before it; now and then one is *full*, so that no more than a hundred
have to be read. The number of a holder's first generation is its *epoch*: its objects are below
``published/EPOCH.N/``, so no two holders ever write the same key.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

__all__ = ["MANIFESTS", "OBJECTS", "Manifest", "Part", "epoch_of", "manifest_key"]

MANIFESTS, OBJECTS = "manifests", "published"

_OBJECT = re.compile(rf"{OBJECTS}/(\d+)\.\d+[-./].*")


@dataclass(frozen=True, slots=True)
class Part:
    """Successive bytes of a file.

    Attributes
    ----------
    key : str
        Of the object that they are in.
    begin, size : int
        Where they are in it.
    digest : str
        SHA-256 of these bytes, its first half, in hexadecimal.
    """

    key: str
    begin: int
    size: int
    digest: str


@dataclass(frozen=True, slots=True)
class Manifest:
    """A generation.

    Attributes
    ----------
    generation : int
        From 1.
    epoch : int
        Generation with which its holder began.
    owner : str
        The holder, and no other one.
    ended : bool
        Whether the holder publishes no more, so that nobody has to wait for it.
    since : int
        The newest full generation up to this one.
    files : mapping of str to sequence of Part
        Path in the run's folder → its content; all of a full generation, else those that changed.
    gone : sequence of str
        Files that are deleted.
    """

    generation: int
    epoch: int
    owner: str
    ended: bool
    since: int
    files: Mapping[str, Sequence[Part]] = field(default_factory=dict)
    gone: Sequence[str] = ()

    def content(self) -> bytes:
        """Return the object of this manifest."""
        fields = asdict(self) | {
            "files": {
                path: [[part.key, part.begin, part.size, part.digest] for part in parts]
                for path, parts in self.files.items()
            }
        }
        return json.dumps(fields, separators=(",", ":")).encode()

    @classmethod
    def read(cls, content: bytes) -> Manifest:
        """Read a manifest; ValueError if it is none."""
        try:
            fields = json.loads(content)
            files = {path: tuple(Part(*part) for part in parts) for path, parts in fields["files"].items()}
            return cls(**fields | {"files": files, "gone": tuple(fields["gone"])})
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"no manifest: {error}") from None


def manifest_key(generation: int) -> str:
    """Return the key of a generation; keys are ordered as generations are."""
    return f"{MANIFESTS}/{generation:012d}.json"


def epoch_of(key: str) -> int | None:
    """Return the epoch of an object of a run; None of any other one."""
    found = _OBJECT.fullmatch(key)
    return None if found is None else int(found[1])
