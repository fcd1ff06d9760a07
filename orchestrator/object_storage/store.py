"""The few requests that are made to an object store, and their faults, whatever library makes them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING, Protocol

from mlbs_actors.errors import ConfigError
from orchestrator.credentials import mask
from orchestrator.object_storage.address import StoreAddress

if TYPE_CHECKING:
    from obstore.store import ObjectStore as RemoteStore

__all__ = ["Content", "MissingObjectError", "ObjectStore", "StoreError", "open_store"]

#: What an object is made of: small ones at once, large ones piece by piece.
Content = bytes | Iterator[bytes]

#: A request that takes longer has failed, s; large objects are many requests.
_REQUEST_SECONDS, _CONNECT_SECONDS = 60, 5

#: For how long a request is repeated by itself, s; after that the publisher waits and tries again.
_RETRY_SECONDS, _RETRIES = 10, 2


class StoreError(Exception):
    """The store cannot be reached, or refuses; it may be tried again."""


class MissingObjectError(StoreError):
    """There is no such object."""


class ObjectStore(Protocol):
    """Objects by their keys, below the run's prefix; every method may raise StoreError.

    A reader sees an object as a whole or not at all, and what was written before.
    """

    def put(self, key: str, content: Content) -> None:
        """Write an object; what its content raises is passed on as it is."""

    def create(self, key: str, content: bytes) -> bool:
        """Write an object unless there is one of that key; return whether it was written."""

    def get(self, key: str, begin: int = 0, size: int | None = None) -> bytes:
        """Read an object, or ``size`` bytes of it from ``begin`` on; MissingObjectError if there is none."""

    def keys(self, prefix: str, after: str = "") -> list[str]:
        """List the keys in a folder, in order, those behind one that is named."""

    def delete(self, keys: Sequence[str]) -> None:
        """Delete objects; those that are missing do not matter."""


def open_store(address: StoreAddress) -> ObjectStore:
    """Connect to a store, with the credentials of the environment; nothing is requested yet.

    Raises
    ------
    ConfigError
        If the package for it is missing, or the address or the credentials cannot be used.
    """
    try:
        import obstore  # of the extra object-storage
        from obstore.exceptions import BaseError
    except ImportError:
        raise ConfigError(
            f"--output {address} needs a package more: pip install 'mlbs-actors[object-storage]'"
        ) from None
    is_folder = address.url.startswith("file://")
    try:
        store = (
            obstore.store.from_url(address.url, mkdir=True)
            if is_folder
            else obstore.store.from_url(
                address.url,
                client_options={
                    "timeout": f"{_REQUEST_SECONDS}s",
                    "connect_timeout": f"{_CONNECT_SECONDS}s",
                    "allow_http": True,  # of a server in one's own network, if the environment names that
                },
                retry_config={"max_retries": _RETRIES, "retry_timeout": timedelta(seconds=_RETRY_SECONDS)},
            )
        )
    except (BaseError, ValueError, OSError) as error:
        raise ConfigError(f"--output {address} cannot be used: {_reason(error)}.") from None
    return _RemoteStore(store)


class _RemoteStore:
    """An :class:`ObjectStore` by means of ``obstore``."""

    def __init__(self, store: RemoteStore) -> None:
        import obstore
        from obstore.exceptions import AlreadyExistsError, PreconditionError

        self._store = store
        self._call = obstore
        self._exists = (AlreadyExistsError, PreconditionError)

    def put(self, key: str, content: Content) -> None:
        faults: list[Exception] = []

        def pieces(content: Iterator[bytes]) -> Iterator[bytes]:
            try:
                yield from content
            except Exception as error:
                faults.append(error)
                raise

        try:
            with _faults(key):
                self._call.put(self._store, key, content if isinstance(content, bytes) else pieces(content))
        except StoreError:
            if faults:
                raise faults[0] from None
            raise

    def create(self, key: str, content: bytes) -> bool:
        with _faults(key):
            try:
                self._call.put(self._store, key, content, mode="create", use_multipart=False)
            except self._exists:
                return False
        return True

    def get(self, key: str, begin: int = 0, size: int | None = None) -> bytes:
        with _faults(key):
            if size is None:
                return bytes(self._call.get(self._store, key).bytes())
            return bytes(self._call.get_range(self._store, key, start=begin, length=size))

    def keys(self, prefix: str, after: str = "") -> list[str]:
        with _faults(prefix):
            pages = self._call.list(self._store, prefix, offset=after or None)
            return sorted(str(one["path"]) for page in pages for one in page)

    def delete(self, keys: Sequence[str]) -> None:
        for key in keys:  # a folder complains of one that is missing
            with _faults(key):
                try:
                    self._call.delete(self._store, key)
                except FileNotFoundError:
                    continue


@contextmanager
def _faults(key: str) -> Iterator[None]:
    from obstore.exceptions import BaseError, NotFoundError

    try:
        yield
    except (FileNotFoundError, NotFoundError):
        raise MissingObjectError(f"there is no {key}") from None
    except (BaseError, OSError, ValueError) as error:
        raise StoreError(_reason(error)) from None


def _reason(error: Exception) -> str:
    """Return the first line of what a library says, which goes on with its own innards, without secrets."""
    return mask(str(error).split("\n", 1)[0]).strip().rstrip(".")
