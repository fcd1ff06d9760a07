"""Faults at an exact place: what a function of the run does when it is called, changed from outside.

A run is started with a folder on its ``PYTHONPATH`` whose ``sitecustomize`` calls :func:`spring` in each of
its processes, those of Ray's actors too. There the traps' functions are replaced as soon as their modules
are imported. The product knows nothing of this.
"""

from __future__ import annotations

import functools
import importlib.abc
import inspect
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, TypeAlias

__all__ = ["Plant", "Trap", "When", "spring"]

When: TypeAlias = Literal["before", "after", "soon after"]

#: How long after a return a process dies that is to die then, s.
_SOON = 0.005

#: Folder that this package is imported from, which need not be on the path of the run.
_IMPORT_ROOT = str(Path(__file__).resolve().parents[2])

#: Actions that go on once they have begun.
_LASTING = ("fail", "wait")


@dataclass(frozen=True, slots=True)
class Trap:
    """What a function is to do.

    Attributes
    ----------
    function : str
        ``module:Class.method`` or ``module:function``.
    action : {"die", "abort", "kill driver", "fail", "wait", "note", "set"}
        The process is killed, aborts, takes the run's driver with it; the call raises OSError, is late, is
        noted; or the name is no function and gets ``value``.
    call : int
        The first call of a process at which that happens, from 0, since the trap was laid or armed; for
        "fail" and "wait" at later ones too.
    when : {"before", "after", "soon after"}
        The call, or the return.
    times : int
        How often at most in the whole run; "fail", "wait" and "note" have no end.
    value : float
        The number of the error, the seconds to wait, what to set.
    process : str
        How the titles of the processes begin in which that happens.
    armed : bool
        Whether it is from the start; else :meth:`Plant.arm` does it.
    """

    function: str
    action: Literal["die", "abort", "kill driver", "fail", "wait", "note", "set"]
    call: int = 0
    when: When = "before"
    times: int = 1
    value: float = 0.0
    process: str = ""
    armed: bool = True


class Plant:
    """A folder that brings traps into every process of a run.

    Parameters
    ----------
    folder : Path
        Made here.
    traps : sequence of Trap
    """

    def __init__(self, folder: Path, traps: Sequence[Trap]) -> None:
        folder.mkdir(parents=True)
        self._traps = tuple(traps)
        (folder / "traps.json").write_text(json.dumps([asdict(trap) for trap in traps]))
        (folder / "sitecustomize.py").write_text(
            f"import sys\nsys.path.insert(0, {_IMPORT_ROOT!r})\n"
            f"from {__name__} import spring\ndel sys.path[0]\n"
            f"spring({str(folder)!r})\n"
        )
        self._folder = folder
        for trap in traps:
            if trap.armed:
                self.arm(trap)

    def arm(self, trap: Trap) -> None:
        """Let one of the traps snap from now on, in processes that run already too."""
        _arming(self._folder, self._traps.index(trap)).touch()

    def disarm(self, trap: Trap) -> None:
        """Let one of the traps snap no more."""
        _arming(self._folder, self._traps.index(trap)).unlink()

    def environment(self) -> dict[str, str]:
        """The environment with which a run has the traps."""
        paths = [str(self._folder), *filter(None, [os.environ.get("PYTHONPATH")])]
        return os.environ | {"PYTHONPATH": os.pathsep.join(paths)}

    def tell_driver(self, pid: int) -> None:
        """Say which process is the run's driver."""
        (self._folder / "driver").write_text(str(pid))

    @property
    def sprung(self) -> int:
        """How often traps have snapped."""
        return len([*self._folder.glob("sprung-*")])

    def has_sprung(self, trap: Trap) -> bool:
        """Whether one of the traps has snapped."""
        return any(self._folder.glob(f"sprung-{self._traps.index(trap)}-*"))

    def noted(self, trap: Trap) -> list[float]:
        """When processes first came to a trap that notes it: one time each, monotonic, s, in order."""
        notes = self._folder.glob(f"noted-{self._traps.index(trap)}-*")
        return sorted(float(text) for note in notes if (text := note.read_text()))


def spring(folder: str) -> None:
    """Lay the traps of a :class:`Plant` in this process."""
    traps = [Trap(**fields) for fields in json.loads((Path(folder) / "traps.json").read_text())]
    by_module: dict[str, list[_Laid]] = {}
    for number, trap in enumerate(traps):
        module, _, name = trap.function.partition(":")
        by_module.setdefault(module, []).append(_Laid(trap, name, Path(folder), number))
    for module, laid in by_module.items():
        if module in sys.modules:
            _lay(sys.modules[module], laid)
    sys.meta_path.insert(0, _Finder(by_module))


class _Laid:
    """A trap in this process."""

    def __init__(self, trap: Trap, name: str, folder: Path, number: int) -> None:
        self.trap = trap
        self.name = name
        self._folder = folder
        self._number = number
        self._calls = 0

    def replacement(self, function: Any) -> Any:
        """What takes the function's place."""
        if self.trap.action == "set":
            return type(function)(self.trap.value)
        if inspect.iscoroutinefunction(function):

            @functools.wraps(function)
            async def replaced_coroutine(*arguments: Any, **named: Any) -> Any:
                with self._around():
                    return await function(*arguments, **named)

            return replaced_coroutine

        @functools.wraps(function)
        def replaced(*arguments: Any, **named: Any) -> Any:
            with self._around():
                return function(*arguments, **named)

        return replaced

    @contextmanager
    def _around(self) -> Iterator[None]:
        snaps = self._snaps()
        if snaps and self.trap.when == "before":
            self._act()
        yield
        if snaps and self.trap.when == "after":
            self._act()
        elif snaps and self.trap.when == "soon after":
            threading.Timer(_SOON, self._act).start()

    def _snaps(self) -> bool:
        if not Path("/proc/self/cmdline").read_text(errors="replace").startswith(self.trap.process):
            return False
        if not _arming(self._folder, self._number).exists():
            return False
        call, self._calls = self._calls, self._calls + 1
        return call == self.trap.call or (self.trap.action in _LASTING and call > self.trap.call)

    def _act(self) -> None:
        action, value = self.trap.action, self.trap.value
        if action == "note":
            note = self._folder / f"noted-{self._number}-{os.getpid()}"
            note.write_text(repr(time.monotonic()))
            return
        if not self._counted():
            return
        if action == "wait":
            time.sleep(value)
        elif action == "fail":
            raise OSError(int(value), os.strerror(int(value)))
        elif action == "abort":
            os.abort()
        if action == "kill driver":
            os.kill(int((self._folder / "driver").read_text()), signal.SIGKILL)
        if action in ("die", "kill driver"):
            os.kill(os.getpid(), signal.SIGKILL)

    def _counted(self) -> bool:
        """Note that the trap snaps, unless it has done so often enough in whatever process."""
        if self.trap.action in _LASTING:
            (self._folder / f"sprung-{self._number}-0").touch()
            return True
        for time_ in range(self.trap.times):
            try:
                (self._folder / f"sprung-{self._number}-{time_}").touch(exist_ok=False)
            except FileExistsError:
                continue
            return True
        return False


def _arming(folder: Path, number: int) -> Path:
    """The file that is there while a trap is armed."""
    return folder / f"armed-{number}"


class _Finder(importlib.abc.MetaPathFinder):
    """Lets modules be found as ever, and lays the traps once they are executed."""

    def __init__(self, by_module: Mapping[str, Sequence[_Laid]]) -> None:
        self._by_module = by_module

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname not in self._by_module:
            return None
        for finder in sys.meta_path:
            spec = None if finder is self else finder.find_spec(fullname, path, target)
            if spec is not None and spec.loader is not None:
                spec.loader.exec_module = functools.partial(  # type: ignore[method-assign]
                    _execute_and_lay, spec.loader.exec_module, self._by_module[fullname]
                )
                return spec
        return None


def _execute_and_lay(
    execute: Callable[[ModuleType], None], traps: Sequence[_Laid], module: ModuleType
) -> None:
    execute(module)
    _lay(module, traps)


def _lay(module: ModuleType, traps: Sequence[_Laid]) -> None:
    for laid in traps:
        owner: Any = module
        *outer, name = laid.name.split(".")
        for step in outer:
            owner = getattr(owner, step)
        setattr(owner, name, laid.replacement(getattr(owner, name)))
