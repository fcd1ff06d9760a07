"""An object store in memory, which can be killed or go away at any request."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections.abc import Callable, Sequence

from orchestrator.object_storage.store import Content, MissingObjectError, StoreError


class KilledError(BaseException):
    """What a process does after it was killed: nothing."""


class MemoryStore:
    """An :class:`ObjectStore`.

    Attributes
    ----------
    objects : dict of str to bytes
    requests : list of str
        Those that were made, as ``put KEY``.
    before, after : callable
        Called with each request, before and after it has an effect; may raise.
    """

    def __init__(self) -> None:
        self.objects: dict[str, bytes] = {}
        self.requests: list[str] = []
        self.before: Callable[[str], None] = lambda request: None
        self.after: Callable[[str], None] = lambda request: None
        self._lock = threading.Lock()

    def put(self, key: str, content: Content) -> None:
        whole = content if isinstance(content, bytes) else b"".join(content)
        self._request(f"put {key}", lambda: self.objects.update({key: whole}))

    def create(self, key: str, content: bytes) -> bool:
        done: list[bool] = []

        def act() -> None:
            done.append(key not in self.objects)
            self.objects.setdefault(key, content)

        self._request(f"create {key}", act)
        return done[0]

    def get(self, key: str, begin: int = 0, size: int | None = None) -> bytes:
        found: list[bytes] = []

        def act() -> None:
            if key not in self.objects:
                raise MissingObjectError(f"there is no {key}")
            found.append(self.objects[key][begin : None if size is None else begin + size])

        self._request(f"get {key}", act)
        return found[0]

    def keys(self, prefix: str, after: str = "") -> list[str]:
        found: list[str] = []

        def act() -> None:
            inside = sorted(key for key in self.objects if key.startswith(f"{prefix}/"))
            found.extend(inside[bisect_right(inside, after) :])

        self._request(f"keys {prefix}", act)
        return found

    def delete(self, keys: Sequence[str]) -> None:
        for key in keys:
            self._request(f"delete {key}", lambda key=key: self.objects.pop(key, None))  # type: ignore[misc]

    def kill_at(self, number: int, *, acted: bool) -> None:
        """Kill at a request, counted from 1 from now on; ``acted`` if it still had its effect."""
        seen, dead = [0], threading.Event()

        def before(request: str) -> None:
            if dead.is_set():
                raise KilledError
            seen[0] += 1
            if seen[0] == number:
                dead.set()
                if not acted:
                    raise KilledError

        def after(request: str) -> None:
            if dead.is_set():
                raise KilledError

        self.before, self.after = before, after

    def go_away(self) -> None:
        """Refuse all requests from now on."""

        def refuse(request: str) -> None:
            raise StoreError("no route to the store")

        self.before = refuse

    def be_there(self) -> None:
        """Serve again, for everybody."""
        self.before = self.after = lambda request: None

    def _request(self, request: str, act: Callable[[], object]) -> None:
        with self._lock:
            self.before(request)
            self.requests.append(request)
            act()
            self.after(request)
