"""A day's life of three cameras, of which an operator changes everything while they run.

Prints how long each change took until it was seen to have an effect; with ``-s`` it is shown.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, get_args

import pytest
from moving_cameras import moving_cameras

from chaos.harness.webhook import Webhook
from orchestrator.events.event import EventKind

REPOSITORY = Path(__file__).resolve().parents[2]

#: Longest wait for anything, s: a machine that does other things, too, is slow.
PATIENCE = 120.0

#: Kinds of events that are written, but not sent by default.
UNSENT = ("born", "hidden", "back", "ended")

ALL_KINDS: tuple[EventKind, ...] = get_args(EventKind)

RULES = "[{{name: stays, dwell: {{zone: middle, seconds: 0.4}}, schedule: {{{}, timezone: UTC}}}}]"

ZONES = "[{{name: {}, polygon: [[0.3, 0], [0.7, 0], [0.7, 1], [0.3, 1]]}}]"


class Day:
    """The file of cameras, the command that follows it, and what it has written."""

    def __init__(self, folder: Path, disk: Path, targets: str, *, killed: bool) -> None:
        self.file, self.output = folder / "cameras.yaml", disk / "out"
        self.streams: dict[str, dict[str, str]] = {}
        self.target = {"url": targets}
        self.table: list[tuple[float, str]] = []
        self.kills = 0
        self._is_killed = killed
        self._errors = folder / "stderr"
        self.process: subprocess.Popen[bytes]

    def start(self) -> None:
        """Start the command, for the first time or once more."""
        command = ["--streams", self.file, "--watch", "--resume", "--output", self.output, "--places", "6"]
        with self._errors.open("ab") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "orchestrator", *map(str, command)],
                cwd=REPOSITORY,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
            )

    def stop(self, number: int) -> int:
        """Send the command a signal; return its status."""
        self.kills += number == signal.SIGKILL
        self.process.send_signal(number)
        return self.process.wait(PATIENCE)

    def write(self, mistake: str = "") -> None:
        """Write the file of cameras, as an editor does."""
        lines = ["events:", *_item(self.target, "  "), "streams:"]
        for name, keys in self.streams.items():
            lines += [f"  {name}:", *(f"    {key}: {value}" for key, value in keys.items())]
        draft = self.file.with_suffix(".part")
        draft.write_text("\n".join([*lines, mistake]) + "\n")
        draft.replace(self.file)

    def status(self) -> dict[str, Any]:
        """Return what the run says of itself."""
        status: dict[str, Any] = json.loads((self.output / "status.json").read_text())
        return status

    def state(self, name: str) -> dict[str, Any]:
        """Return what the status says of a stream."""
        found: dict[str, Any] = self.status()["streams"].get(name, {"state": None, "read": 0})
        return found

    def events(self, name: str) -> list[dict[str, Any]]:
        """Return the events of a stream."""
        path = self.output / name / "events.jsonl"
        return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []

    def said(self) -> str:
        """Return the messages so far."""
        return self._errors.read_text()

    def until(self, what: str, holds: Callable[[], object]) -> None:
        """Wait for something, and note how long that took."""
        began = time.monotonic()
        while True:
            try:
                if holds():
                    break
            except (OSError, ValueError, IndexError):  # not there yet, or being replaced
                pass
            assert time.monotonic() - began < PATIENCE, f"{what}: never\n{self.said()}"
            assert self.process.poll() is None, self.said()
            time.sleep(0.05)
        self.table.append((time.monotonic() - began, what))

    def change(self, what: str, holds: Callable[[], object]) -> None:
        """Write the file, wait for what that changes, and kill the command on a day when it is killed."""
        self.write()
        self.until(what, holds)
        if self._is_killed:
            self.stop(signal.SIGKILL)
            self.start()
            for name in self.streams:
                self.until(f"  after a kill {name} goes on", self.goes_on(name))

    def goes_on(self, name: str) -> Callable[[], bool]:
        """Return a check that a stream has read more than now."""
        before: int = self.state(name)["read"]
        return lambda: bool(self.state(name)["state"] == "running" and self.state(name)["read"] > before + 5)


def _item(keys: dict[str, str], indent: str) -> list[str]:
    """Return an item of a YAML list."""
    first, *others = (f"{key}: {value}" for key, value in keys.items())
    return [f"{indent}- {first}", *(f"{indent}  {line}" for line in others)]


@contextmanager
def day(folder: Path, disk: Path, targets: str, *, killed: bool) -> Iterator[Day]:
    """Begin a day, and leave no process of it."""
    one = Day(folder, disk, targets, killed=killed)
    try:
        yield one
    finally:
        if one.process.poll() is None:
            os.killpg(one.process.pid, signal.SIGKILL)
            one.process.wait()
        print(*(f"{seconds:6.1f} s  {what}" for seconds, what in one.table), sep="\n")


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A small disk of its own, where that can be had; else a folder."""
    path = tmp_path / "disk"
    path.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=256m", "tmpfs", str(path)]
    is_mounted = (
        shutil.which("mount") and subprocess.run(mount, check=False, capture_output=True).returncode == 0
    )
    yield path
    if is_mounted:
        subprocess.run(["umount", "--lazy", str(path)], check=True)


@pytest.mark.long
@pytest.mark.timeout(2400)
@pytest.mark.parametrize("killed", [False, True], ids=["at work", "killed after each change"])
def test_everything_is_changed_while_the_cameras_run(tmp_path: Path, disk: Path, killed: bool) -> None:
    hook = Webhook()
    with (
        moving_cameras(gate="one", lane="two", yard="three") as cameras,
        day(tmp_path, disk, hook.url, killed=killed) as one,
    ):
        gate = {"source": cameras.address("gate"), "zones": ZONES.format("mid"), "save": "[masks, parquet]"}
        one.streams = {"gate": gate, "lane": {"source": cameras.address("lane", "wrong")}}
        one.write()
        one.start()
        one.until("the first start: a zone is entered", lambda: zones_of(one, "gate") == {"mid"})
        one.until("  and a wrong password is told", lambda: one.state("lane")["state"] == "reconnecting")

        one.streams["lane"]["source"] = cameras.address("lane")
        one.change("the password is corrected", lambda: one.state("lane")["state"] == "running")

        gate["zones"] = ZONES.format("middle")
        one.change("a zone is renamed", lambda: kinds_since(one, "gate", "mid") >= {"configured"})
        one.until("  and entered", lambda: "middle" in zones_of(one, "gate"))

        one.streams["yard"] = {"source": cameras.address("yard")}
        one.change("a camera is added: it runs", lambda: one.state("yard")["state"] == "running")

        number = one.events("gate")[-1]["number"]
        gate["max_side"] = "240"
        one.change("another size: a new epoch", lambda: configured(one, "gate", number))
        one.until("  and goes on", one.goes_on("gate"))

        number = one.events("gate")[-1]["number"]
        gate["save"] = "[parquet]"
        one.change("other parts", lambda: configured(one, "gate", number))

        hook.away = True
        one.until("a target is away: events wait", lambda: waiting(one) >= 3)
        number = one.events("gate")[-1]["number"]
        gate["rules"] = RULES.format(hours(away=True))
        one.change("a rule for other hours", lambda: configured(one, "gate", number))
        hook.away = False
        one.until("a target is there again: nothing waits", lambda: waiting(one) == 0)
        assert not any(event["kind"] == "rule" for event in one.events("gate"))

        gate["rules"] = RULES.format(hours(away=False))
        one.change("a rule for these hours", lambda: any(event["kind"] == "rule" for event in hook.events))

        assert not any(event["kind"] in UNSENT for event in hook.events)
        one.target["kinds"] = f"[{', '.join(ALL_KINDS)}]"
        one.change("another filter", lambda: any(event["kind"] in UNSENT for event in hook.events))

        one.write(mistake="  door: {source: ftp://nowhere}")
        one.until("a mistake is told", lambda: "'ftp' is no known kind" in one.said())
        for name in ("gate", "lane", "yard"):
            one.until(f"  and {name} goes on", one.goes_on(name))

        if disk.is_mount():
            filling = fill(disk)
            time.sleep(5.0)
            filling.unlink()
            for name in ("gate", "lane", "yard"):
                one.until(f"a disk was full: {name} goes on", one.goes_on(name))

        one.streams["road"] = {"source": one.streams.pop("lane")["source"], "was": "lane"}
        before = one.state("lane")["committed"]
        one.change("a camera is renamed: it runs", lambda: one.state("road")["state"] == "running")
        one.until("  with its history", lambda: one.state("road")["committed"] >= before)
        assert not (one.output / "lane").exists()

        del one.streams["yard"]
        one.change("a camera is removed: it has ended", lambda: one.state("yard")["state"] == "done")

        one.stop(signal.SIGKILL)
        one.write(mistake="  door: [")
        one.start()
        time.sleep(5.0)
        assert one.process.poll() is None, one.said()
        one.write()
        one.until("a file that could not be read is mended", one.goes_on("gate"))
        one.until("  and road goes on", one.goes_on("road"))
        assert one.stop(signal.SIGTERM) == 0, one.said()
        written = [event for name in ("gate", "road", "yard") for event in one.events(name)]
        ids = [event["id"] for event in written]
        assert len(ids) == len(set(ids))
        # What was certain before the kill was sent, though its frames are lost.
        assert {event["id"] for event in written if event["kind"] not in UNSENT} <= set(hook.ids)
        assert len(hook.ids) - len(set(hook.ids)) <= one.kills  # one whose receipt could not be noted
        assert not any(password in one.said() for password in ("bob:one", "bob:two", "wrong"))
    hook.stop()


def hours(*, away: bool) -> str:
    """Return the present hours, or those on the other side of the day."""
    begin = (time.gmtime().tm_hour + (11 if away else 23)) % 24
    return f'from: "{begin:02d}:00", to: "{(begin + 3) % 24:02d}:00"'


def waiting(one: Day) -> int:
    """Return how many events wait for the target."""
    return sum(target["waiting"] for target in one.status()["events"])


def fill(disk: Path) -> Path:
    """Leave no room on a disk; return the file that fills it."""
    path = disk / "filling"
    with path.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(65536))
    return path


def zones_of(one: Day, name: str) -> set[str]:
    """Return the zones that were entered."""
    return {event["zone"] for event in one.events(name) if event["kind"] == "entered"}


def kinds_since(one: Day, name: str, zone: str) -> set[str]:
    """Return the kinds of events after the last one of a zone."""
    events = one.events(name)
    last = max((place for place, event in enumerate(events) if event["zone"] == zone), default=-1)
    return {event["kind"] for event in events[: last + 1]} | {event["kind"] for event in events[last:]}


def configured(one: Day, name: str, number: int) -> bool:
    """Whether the stream has other settings since the event of a number."""
    return any(event["kind"] == "configured" and event["number"] > number for event in one.events(name))
