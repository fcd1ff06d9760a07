"""Kill, interrupt or start the command twice, or fail its disk; then ``--resume``."""

from __future__ import annotations

import errno
import pickle
import signal
import time
from pathlib import Path

from chaos.harness.end_series import frames_for_ends, kill, run_end_series
from chaos.harness.fault_series import FaultSeries, Inject
from chaos.harness.injection import Injection, Injector
from chaos.harness.observed_run import ObservedRun, expect
from chaos.harness.scenario import Fault, Scenario, ScenarioContext, Verdicts, expect_end, victim

__all__ = ["SCENARIOS"]


def _interrupted(number: signal.Signals, signals: int) -> Inject:
    def inject(run: ObservedRun, injector: Injector) -> None:
        for _ in range(signals):
            run.signal_driver(number)
            time.sleep(0.1)
        expect_end(run, 128 + number)

    return inject


def _two_runs_on_one_folder(run: ObservedRun, injector: Injector) -> None:
    folder = run.output.parent
    for flags in ((), ("--resume",)):
        with ObservedRun(run.lines, folder, *flags) as second:
            expect_end(second, 2)
    expect(not run.ended, "the first run has ended")


def _killed_and_files_damaged(run: ObservedRun, injector: Injector) -> None:
    run.wait(lambda: bool([*run.output.glob("victim/snapshots/*/*/parts")]), "a snapshot")
    kill(run, injector)
    run.expect_clean()  # or its processes would write among the damaged files
    _damage_files(run.output)


def _damage_files(output: Path) -> None:
    """Tear the last line, damage the newest snapshot, and add a foreign pickle to the snapshots."""
    with (output / "victim/commits.jsonl").open("a", encoding="utf-8") as lines:
        lines.write('{"generation": 0, "first": 6')
    lists = output.glob("victim/snapshots/*/*/parts")
    newest = max(lists, key=lambda path: path.stat().st_mtime).with_name("coordinator")
    data = bytearray(newest.read_bytes())
    data[len(data) // 2] ^= 1
    newest.write_bytes(data)
    foreign = output / "victim/snapshots/99/00000001"
    foreign.mkdir(parents=True)
    (foreign / "parts").write_bytes(pickle.dumps(Path("/tmp")))


def _disk_fails(failure: Injection) -> Inject:
    """Let publishing fail: the streams fail, and what was committed is kept."""

    def inject(run: ObservedRun, injector: Injector) -> None:
        injector.arm(failure)
        stderr = expect_end(run, 1)
        injector.disarm(failure)
        expect("cannot be written" in stderr, f"the error is not reported: {stderr}")

    return inject


def _publishing_fails(context: ScenarioContext, number: int) -> Injection:
    return Injection(
        "orchestrator.storage.durable_files:publish",
        "fail",
        int(context.random.integers(3)),
        value=number,
        process="ray::SinkActor",
        armed=False,
    )


_FAULTS = (
    Fault("21", "two runs on one folder"),
    Fault("19", "driver killed, then --resume"),
    Fault("20", "a signal, then --resume"),
    Fault("20", "a second signal, then --resume"),
    Fault("27", "driver killed, files damaged, then --resume"),
    Fault("22", "disk full, then --resume"),
    Fault("22", "disk quota reached, then --resume"),
    Fault("23", "output folder read-only, then --resume"),
)


def _one_after_the_other(context: ScenarioContext, verdicts: Verdicts) -> None:
    one, two = (
        signal.SIGINT if interrupt else signal.SIGTERM for interrupt in context.random.integers(2, size=2)
    )
    errors = errno.ENOSPC, errno.EDQUOT, errno.EROFS
    failures = tuple(_publishing_fails(context, number) for number in errors)
    ends = (
        _two_runs_on_one_folder,
        kill,
        _interrupted(one, 1),
        _interrupted(two, 2),
        _killed_and_files_damaged,
        *map(_disk_fails, failures),
    )
    chosen = [(fault.name, end) for fault, end in zip(_FAULTS, ends, strict=True) if fault.name in verdicts]
    # A stream alone: whatever ends the command hits all of its streams.
    lines = (victim(frames_for_ends(len(chosen))),)
    run_end_series(FaultSeries(context, verdicts, chosen, lines, failures))


SCENARIOS = (Scenario("the command ended one way after the other", _FAULTS, _one_after_the_other),)
