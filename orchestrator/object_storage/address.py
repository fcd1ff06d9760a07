"""Addresses of object stores, as ``--output`` takes them; nothing has to be installed to read one."""

from __future__ import annotations

import hashlib
import os
import re
from dataclasses import dataclass
from pathlib import Path

from orchestrator.credentials import mask

__all__ = ["StoreAddress", "parse_store_address", "scratch_place"]

#: What a prefix is of, by the scheme of the address.
_SCHEMES = ("s3", "gs", "az", "abfs", "abfss", "file")

_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


@dataclass(frozen=True, slots=True)
class StoreAddress:
    """Where a run's objects are: ``s3://BUCKET/PREFIX``, without a slash at its end."""

    url: str

    def __str__(self) -> str:
        return self.url


def parse_store_address(text: str) -> StoreAddress | None:
    """Read an address; None of what is no address of an object store.

    Raises
    ------
    ValueError
        If it is one that cannot be used, with the rest of a sentence that begins with the option.
    """
    scheme, separator, place = text.partition("://")
    if not separator or scheme not in _SCHEMES:
        return None
    if "?" in place or "#" in place or (scheme in ("s3", "gs") and "@" in place):
        raise ValueError(
            f"takes {scheme}://BUCKET/PREFIX alone, not {mask(text)!r}; credentials and the server come from "
            "the environment."
        )
    place = place.rstrip("/")
    if not place.strip("/").partition("/")[2] and scheme != "file":
        raise ValueError(f"takes {scheme}://BUCKET/PREFIX; name a prefix of the run's own behind {text!r}.")
    if scheme == "file" and not place.startswith("/"):
        raise ValueError(f"takes file:///ABSOLUTE/PATH, not {text!r}.")
    return StoreAddress(f"{scheme}://{place}")


def scratch_place(address: StoreAddress, root: Path | None) -> Path:
    """Return the folder in which a run at an address works on this machine.

    Parameters
    ----------
    address : StoreAddress
    root : Path, optional
        Where such folders are; by default where programs keep what must last, as a cache may be emptied.
    """
    if root is None:
        state = os.environ.get("XDG_STATE_HOME")
        root = (Path(state) if state else Path("~/.local/state").expanduser()) / "mlbs-actors"
    name = _UNSAFE.sub("-", address.url.rpartition("/")[2])
    return root.absolute() / f"{name}-{hashlib.sha256(address.url.encode()).hexdigest()[:8]}"
