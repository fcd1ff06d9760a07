"""Ray for one run: started on this machine with safe settings, or a cluster that is joined.

Anybody who reaches Ray's ports can run code. So our own session listens on this machine only, requires a
token that only this user can read, and has no dashboard. A cluster is joined only with ``--address``:
``RAY_ADDRESS`` in the environment, which Ray sets for submitted jobs, counts only with ``--address auto``.
"""

from __future__ import annotations

import fcntl
import io
import logging
import os
import secrets
import shutil
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, redirect_stdout
from pathlib import Path

from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.early_signals import exit_if_signalled
from orchestrator.module_path import PACKAGE_ROOT
from orchestrator.ray_head import RayHead, ray_head

__all__ = ["joined_ray", "ray_session", "ray_settings", "starting_ray"]

#: Object store for frames, label maps and posteriors, a few of each stream, bytes.
_OBJECT_STORE_BYTES = 2 * 2**30

_CONNECT_SECONDS = 10.0

#: Timeout that disables an activity of Ray, s.
_NEVER_SECONDS = "1e9"

#: How long processes of Ray may keep writing after its end, s.
_LATE_SECONDS = 5.0

# Ray's sockets must have short paths, and TMPDIR may be long.
_SCRATCH_PARENT = Path("/tmp")
_SCRATCH_PREFIX = "mlbs-ray-"


@contextmanager
def ray_settings(address: str | None) -> Iterator[Path]:
    """Set Ray's environment for a run and make its scratch folder; both are undone on exit.

    Ray reads its settings on import, so this must precede the first import of a module that uses Ray.

    Parameters
    ----------
    address : str, optional
        Cluster to join, whose own settings then count; None for a session of our own.

    Yields
    ------
    Path
        Folder for the files of a session of our own, readable by this user only.

    Raises
    ------
    RuntimeError
        If Ray is imported already.
    """
    if "ray" in sys.modules:
        raise RuntimeError("Ray is imported already and would ignore the settings; call ray_settings before.")
    _remove_abandoned()
    scratch, own = _new_scratch()
    # Nor may a late call, after the end of the run, start a session of another kind.
    settings: dict[str, str | None] = {"RAY_ENABLE_AUTO_CONNECT": "0"}
    if address != "auto":
        settings["RAY_ADDRESS"] = None
    if address is None:
        token = scratch / "token"
        token.touch(mode=0o600)
        token.write_text(secrets.token_hex(32), encoding="ascii")
        settings |= {
            "RAY_AUTH_MODE": "token",
            "RAY_AUTH_TOKEN": None,
            "RAY_AUTH_TOKEN_PATH": str(token),
            "RAY_USAGE_STATS_ENABLED": "0",
            # Named after other systems, but with clusters off Ray listens on the loopback address only.
            "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
            # Reporting every call to a dashboard that does not exist costs some per cent of the call.
            "RAY_task_events_report_interval_ms": "0",
            "RAY_event_stats": "0",
            # Without it Ray warns of what it will do to processes that ask for no GPU.
            "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
            # Ray sets its processes to niceness 15. Beside such processes one of SCHED_IDLE, which is being
            # prepared, gets a thirteenth of a core, in one piece: frames waited 50 ms.
            "RAY_worker_niceness": "0",
            # Ray forwards the output of processes to drivers that want it; ours does not. Polling
            # their files ten times a second took half as much as everything else of an idle Ray.
            "RAY_LOG_MONITOR_MANY_FILES_THRESHOLD": "0",
            "LOG_NAME_UPDATE_INTERVAL_S": _NEVER_SECONDS,
        }
    try:
        with _environment(settings):
            yield scratch
    finally:
        _remove(scratch)
        os.close(own)


def _remove(scratch: Path) -> None:
    """Remove a folder in which a late process of Ray may still write."""
    deadline = time.monotonic() + _LATE_SECONDS
    while scratch.exists() and time.monotonic() < deadline:
        shutil.rmtree(scratch, ignore_errors=True)
        time.sleep(0.01)


def _new_scratch() -> tuple[Path, int]:
    """Make a folder that belongs to this process while the returned descriptor is open.

    Another run that begins at the same moment may find the folder not locked yet and remove it at any point
    between these lines; then it is made again.
    """
    while True:
        scratch = Path(tempfile.mkdtemp(prefix=f"{_SCRATCH_PREFIX}{os.getpid()}-", dir=_SCRATCH_PARENT))
        try:
            own = os.open(scratch, os.O_RDONLY)
        except FileNotFoundError:
            continue
        fcntl.flock(own, fcntl.LOCK_EX)
        if scratch.exists():
            return scratch, own
        os.close(own)


def _remove_abandoned() -> None:
    """Remove folders of this user's killed runs, whose locks the system has released."""
    for folder in _SCRATCH_PARENT.glob(f"{_SCRATCH_PREFIX}*"):
        try:
            if folder.stat().st_uid != os.getuid():
                continue
            descriptor = os.open(folder, os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY)
        except OSError:
            continue
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(folder, ignore_errors=True)
        except BlockingIOError:
            continue
        finally:
            os.close(descriptor)


@contextmanager
def ray_session(address: str | None, scratch: Path, metrics_port: int | None = None) -> Iterator[None]:
    """Keep a Ray session while the ``with`` block runs: :func:`starting_ray` and :func:`joined_ray`."""
    with starting_ray(address, scratch, metrics_port) as head, joined_ray(address, head):
        yield


@contextmanager
def starting_ray(
    address: str | None, scratch: Path, metrics_port: int | None = None
) -> Iterator[RayHead | None]:
    """Run Ray on this machine while the ``with`` block runs; it starts in parallel with it.

    Parameters
    ----------
    address : str, optional
        Of a cluster to join, ``HOST:PORT`` or ``auto``: then nothing is started.
    scratch : Path
        From :func:`ray_settings`.
    metrics_port : int, optional
        Of this machine, where Ray exports its metrics to Prometheus.

    Yields
    ------
    RayHead or None
        For :func:`joined_ray`.

    Raises
    ------
    ConfigError
        If metrics cannot be exported.
    """
    if address is not None:
        yield None
        return
    if metrics_port is not None:
        _refuse_unexportable(metrics_port)
    options = {
        "logging_level": logging.ERROR,
        "object_store_memory": _object_store_bytes(),
        "_temp_dir": str(scratch),
        "_metrics_export_port": metrics_port,
    }
    exit_if_signalled()
    with ray_head(scratch, options) as head:
        yield head


@contextmanager
def joined_ray(address: str | None, head: RayHead | None) -> Iterator[None]:
    """Take part in a Ray session while the ``with`` block runs; then our own begins to end.

    Parameters
    ----------
    address : str, optional
        As for :func:`starting_ray`.
    head : RayHead, optional
        From there.

    Raises
    ------
    ConfigError
        If the cluster cannot be joined.
    MlbsError
        If Ray does not start.
    """
    import ray

    with ExitStack() as session:
        try:
            if head is not None:
                joined = head.address()
                session.callback(head.begin_to_end)
            else:
                assert address is not None
                _refuse_unreachable(address)
                joined = address
            exit_if_signalled()
            session.callback(_shut_down)
            with _unchanged_handler(), _folder_for_processes():
                ray.init(address=joined, log_to_driver=False, logging_level=logging.ERROR)
            exit_if_signalled()
        except Exception as error:
            raise _start_failure(address, error) from error
        yield


def _shut_down() -> None:
    """Leave the session quietly: Ray prints repeated warnings that it has held back."""
    import ray

    with redirect_stdout(io.StringIO()):
        ray.shutdown()


@contextmanager
def _unchanged_handler() -> Iterator[None]:
    """Keep the handler of SIGTERM, which Ray replaces by one that exits with another status."""
    handler = signal.getsignal(signal.SIGTERM)
    try:
        yield
    except SystemExit as end:
        if end.code != signal.SIGTERM:  # that of Ray's handler
            raise
        raise SystemExit(128 + signal.SIGTERM) from None
    finally:
        signal.signal(signal.SIGTERM, handler)


@contextmanager
def _folder_for_processes() -> Iterator[None]:
    """Work in the package's own folder: Ray's processes look for modules where it is joined from."""
    before = Path.cwd()
    os.chdir(PACKAGE_ROOT)
    try:
        yield
    finally:
        os.chdir(before)


def _refuse_unreachable(address: str) -> None:
    """Raise OSError or ValueError if nothing listens at HOST:PORT; Ray itself would try for minutes."""
    if address == "auto":
        return
    host, _, port = address.rpartition(":")
    if not (host and port.isdecimal()):
        raise ValueError("an address is HOST:PORT, or auto")
    with socket.create_connection((host, int(port)), timeout=_CONNECT_SECONDS):
        return


def _refuse_unexportable(port: int) -> None:
    """Raise ConfigError if Ray could not export metrics at this port; it would continue silently."""
    try:
        import ray.dashboard.optional_deps  # noqa: F401
    except ImportError:
        raise ConfigError(
            "--ray-metrics needs the exporter of Ray; pip install 'mlbs-actors[ray-metrics]'."
        ) from None
    try:
        socket.create_server(("127.0.0.1", port)).close()
    except OSError as error:
        raise ConfigError(
            f"--ray-metrics cannot listen at port {port}: {error.strerror}. Choose another one."
        ) from None


def _start_failure(address: str | None, error: Exception) -> MlbsError:
    reason = (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(".")
    if address is None:
        return MlbsError(
            f"Ray could not be started on this machine: {reason}. "
            "Look for free memory, and for space in /tmp and /dev/shm."
        )
    if address == "auto" and isinstance(error, ConnectionError):
        return ConfigError(
            "--address auto finds no Ray on this machine; start it as a node with ray start, or give the "
            "HOST:PORT of a cluster."
        )
    return ConfigError(
        f"The Ray cluster at {address} cannot be joined: {reason}. "
        "Check --address, and that this machine is one of its nodes."
    )


@contextmanager
def _environment(settings: Mapping[str, str | None]) -> Iterator[None]:
    """Set environment variables (None: unset) and restore them on exit."""
    before = {name: os.environ.get(name) for name in settings}
    _apply(settings)
    try:
        yield
    finally:
        _apply(before)


def _apply(settings: Mapping[str, str | None]) -> None:
    for name, value in settings.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def _object_store_bytes() -> int:
    """Return at most half of the shared memory: if that is small (containers), Ray would use the disk."""
    try:
        free = shutil.disk_usage("/dev/shm").free
    except OSError:
        return _OBJECT_STORE_BYTES
    return max(96 * 2**20, min(_OBJECT_STORE_BYTES, free // 2))
