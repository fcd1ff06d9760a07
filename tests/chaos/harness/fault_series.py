"""Many faults one after the other: what a run that survives them and runs that they end have in common."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path

from chaos.harness.injection import Injection, Injector
from chaos.harness.observed_run import ObservedRun
from chaos.harness.scenario import RecoveryTime, ScenarioContext, Verdicts

__all__ = ["LABELLED", "FaultSeries", "Inject", "newest_label_map", "time_recovery"]

#: Records when a segmenter has made its first label map: a stream that was restored has a new one, though
#: perhaps in a process that has served another stream before.
LABELLED = Injection("mlbs_actors.actors.stream.segmenter_actor:SegmenterActor.step", "record", when="after")

Inject = Callable[[ObservedRun, Injector], None]


@dataclass(frozen=True, slots=True)
class FaultSeries:
    """Faults to inject into the same streams.

    Attributes
    ----------
    context : ScenarioContext
    verdicts : Verdicts
    faults : sequence of str and callable
        Their names, and what injects each into a run.
    lines : sequence of str
        Streams that are long enough to be at work when the last fault comes.
    injections : sequence of Injection
        To install in every run.
    """

    context: ScenarioContext
    verdicts: Verdicts
    faults: Sequence[tuple[str, Inject]]
    lines: Sequence[str]
    injections: Sequence[Injection] = ()

    def prepare(self) -> Injector:
        """Label the undisturbed streams; return the injector for all runs."""
        self.context.prepare(self.lines)
        return Injector(self.context.folder / "injector", [LABELLED, *self.injections])


def time_recovery(
    run: ObservedRun, injector: Injector, began: float, newest: Mapping[str, int], hit: Callable[[], Set[str]]
) -> RecoveryTime:
    """Wait until label maps are made again, and until there is one that did not exist before.

    Parameters
    ----------
    run : ObservedRun
    injector : Injector
        Of the run, with :data:`LABELLED`.
    began : float
        Just before something was lost, monotonic, s: what has recovered by the time of this call counts, too.
    newest : mapping of str to int
        Newest label map of each stream at that time.
    hit : callable
        Returns the names of the streams that went back to a snapshot, as far as they are known yet.
    """

    def labelled() -> list[float]:
        return [moment for moment in injector.recorded_times(LABELLED) if moment > began]

    run.wait(lambda: bool(labelled()), "a label map after the loss")
    first = labelled()[0] - began

    def advanced() -> bool:
        return any(
            newest_label_map(run.output / name) > newest[name] or run.status()[name]["state"] == "done"
            for name in hit()
        )

    run.wait(advanced, "a new label map after the loss")
    return RecoveryTime(first, time.monotonic() - began)


def newest_label_map(stream: Path) -> int:
    """Return the number of the newest label map written, committed or not; −1 for none."""
    names = (path.name.lstrip(".").partition(".")[0] for path in (stream / "masks").glob("*"))
    return max((int(name) for name in names), default=-1)
