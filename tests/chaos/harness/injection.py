"""Inject faults at an exact call: change from outside what a function of a run does when it is called.

A run is started with a folder on its ``PYTHONPATH`` whose ``sitecustomize`` calls :func:`install` in each of
its processes, those of Ray's actors too. There the functions are replaced as soon as their modules are
imported. The product knows nothing of this.
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

__all__ = ["Injection", "Injector", "When", "install"]

When: TypeAlias = Literal["before", "after", "soon after"]

#: Delay of an action that comes soon after a return, s.
_SOON_SECONDS = 0.005

#: Folder that this package is imported from, which need not be on the path of the run.
_IMPORT_ROOT = str(Path(__file__).resolve().parents[2])

#: Actions that are repeated at every later call.
_REPEATED = ("fail", "wait")


@dataclass(frozen=True, slots=True)
class Injection:
    """A fault at the calls of one function.

    Attributes
    ----------
    function : str
        ``module:Class.method`` or ``module:function``.
    action : {"die", "abort", "kill driver", "fail", "wait", "record", "set"}
        The process is killed, aborts, or is killed with the run's driver; the call raises OSError, is
        delayed, or its time is recorded; or the name is no function and is set to ``value``.
    call : int
        The first call of a process at which that happens, from 0, counted while the injection is armed; for
        "fail" and "wait" at later ones too. "record" is of a method: its first call for each object, or for
        what the object has become since it dropped all that it held.
    when : {"before", "after", "soon after"}
        The call, after its return, or a moment later.
    times : int
        How often at most in the whole run; "fail", "wait" and "record" are not limited.
    value : float
        The number of the error, the seconds to wait, the value to set.
    process : str
        Prefix of the titles of the processes in which that happens.
    armed : bool
        Whether it is armed from the start; else :meth:`Injector.arm` does it.
    """

    function: str
    action: Literal["die", "abort", "kill driver", "fail", "wait", "record", "set"]
    call: int = 0
    when: When = "before"
    times: int = 1
    value: float = 0.0
    process: str = ""
    armed: bool = True


class Injector:
    """A folder that installs injections in every process of a run.

    Parameters
    ----------
    folder : Path
        Created here.
    injections : sequence of Injection
    """

    def __init__(self, folder: Path, injections: Sequence[Injection]) -> None:
        folder.mkdir(parents=True)
        self._injections = tuple(injections)
        (folder / "injections.json").write_text(json.dumps([asdict(injection) for injection in injections]))
        (folder / "sitecustomize.py").write_text(
            f"import sys\nsys.path.insert(0, {_IMPORT_ROOT!r})\n"
            f"from {__name__} import install\ndel sys.path[0]\n"
            f"install({str(folder)!r})\n"
        )
        self._folder = folder
        for injection in injections:
            if injection.armed:
                self.arm(injection)

    def arm(self, injection: Injection) -> None:
        """Let an injection fire from now on, also in processes that are running."""
        _armed_marker(self._folder, self._injections.index(injection)).touch()

    def disarm(self, injection: Injection) -> None:
        """Let an injection fire no more."""
        _armed_marker(self._folder, self._injections.index(injection)).unlink()

    def environment(self) -> dict[str, str]:
        """Return an environment that installs the injections in a run."""
        paths = [str(self._folder), *filter(None, [os.environ.get("PYTHONPATH")])]
        return os.environ | {"PYTHONPATH": os.pathsep.join(paths)}

    def set_driver(self, pid: int) -> None:
        """Set which process is the run's driver."""
        (self._folder / "driver").write_text(str(pid))

    def has_fired(self, injection: Injection) -> bool:
        """Return whether an injection has fired."""
        return any(self._folder.glob(f"fired-{self._injections.index(injection)}-*"))

    def recorded_times(self, injection: Injection) -> list[float]:
        """Return the times that a "record" injection has recorded: one an object, monotonic, s, in order."""
        files = self._folder.glob(f"recorded-{self._injections.index(injection)}-*")
        return sorted(float(text) for file in files if (text := file.read_text()))


def install(folder: str) -> None:
    """Install the injections of an :class:`Injector` in this process."""
    injections = [
        Injection(**fields) for fields in json.loads((Path(folder) / "injections.json").read_text())
    ]
    by_module: dict[str, list[_Installed]] = {}
    for number, injection in enumerate(injections):
        module, _, name = injection.function.partition(":")
        by_module.setdefault(module, []).append(_Installed(injection, name, Path(folder), number))
    for module, installed in by_module.items():
        if module in sys.modules:
            _replace_functions(sys.modules[module], installed)
    sys.meta_path.insert(0, _Finder(by_module))


class _Installed:
    """An injection in this process."""

    def __init__(self, injection: Injection, name: str, folder: Path, number: int) -> None:
        self.injection = injection
        self.name = name
        self._folder = folder
        self._number = number
        self._calls = 0
        self._mark = f"_recorded_{number}"

    def replacement(self, function: Any) -> Any:
        """Return what replaces the function."""
        if self.injection.action == "set":
            return type(function)(self.injection.value)
        if inspect.iscoroutinefunction(function):

            @functools.wraps(function)
            async def replaced_coroutine(*arguments: Any, **named: Any) -> Any:
                with self._around(arguments):
                    return await function(*arguments, **named)

            return replaced_coroutine

        @functools.wraps(function)
        def replaced(*arguments: Any, **named: Any) -> Any:
            with self._around(arguments):
                return function(*arguments, **named)

        return replaced

    @contextmanager
    def _around(self, arguments: Sequence[Any]) -> Iterator[None]:
        fires = self._fires(arguments)
        if fires and self.injection.when == "before":
            self._act()
        yield
        if fires and self.injection.when == "after":
            self._act()
        elif fires and self.injection.when == "soon after":
            threading.Timer(_SOON_SECONDS, self._act).start()

    def _fires(self, arguments: Sequence[Any]) -> bool:
        if not Path("/proc/self/cmdline").read_text(errors="replace").startswith(self.injection.process):
            return False
        if not _armed_marker(self._folder, self._number).exists():
            return False
        call, self._calls = self._calls, self._calls + 1
        if self.injection.action == "record":
            held = vars(arguments[0])
            is_first = self._mark not in held
            held[self._mark] = True
            return is_first
        return call == self.injection.call or (
            self.injection.action in _REPEATED and call > self.injection.call
        )

    def _act(self) -> None:
        action, value = self.injection.action, self.injection.value
        if action == "record":
            file = self._folder / f"recorded-{self._number}-{os.getpid()}-{self._calls}"
            file.write_text(repr(time.monotonic()))
            return
        if not self._count_firing():
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

    def _count_firing(self) -> bool:
        """Count that the injection fires; return False if it has fired often enough, in whichever process."""
        if self.injection.action in _REPEATED:
            (self._folder / f"fired-{self._number}-0").touch()
            return True
        for time_ in range(self.injection.times):
            try:
                (self._folder / f"fired-{self._number}-{time_}").touch(exist_ok=False)
            except FileExistsError:
                continue
            return True
        return False


def _armed_marker(folder: Path, number: int) -> Path:
    """Return the file that exists while an injection is armed."""
    return folder / f"armed-{number}"


class _Finder(importlib.abc.MetaPathFinder):
    """Let other finders find a module, and replace its functions once it has been executed."""

    def __init__(self, by_module: Mapping[str, Sequence[_Installed]]) -> None:
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
                    _execute_and_replace, spec.loader.exec_module, self._by_module[fullname]
                )
                return spec
        return None


def _execute_and_replace(
    execute: Callable[[ModuleType], None], injections: Sequence[_Installed], module: ModuleType
) -> None:
    execute(module)
    _replace_functions(module, injections)


def _replace_functions(module: ModuleType, injections: Sequence[_Installed]) -> None:
    for installed in injections:
        owner: Any = module
        *outer, name = installed.name.split(".")
        for step in outer:
            owner = getattr(owner, step)
        setattr(owner, name, installed.replacement(getattr(owner, name)))
