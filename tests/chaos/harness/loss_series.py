"""One process after the other is lost in one run, and the streams are looked at after each."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence, Set
from pathlib import Path

from chaos.harness.injection import Plant, Trap
from chaos.harness.observed_run import ObservedRun
from chaos.harness.scenario import Back, Place, Verdicts, expect_end, expect_identical, expect_prefix

__all__ = ["LABELLED", "Loss", "bring_about_losses", "frames_for_losses", "newest_label_map", "seconds_back"]

#: What a stream needs for its first snapshot, and gets on between two losses, at most, frames.
_FIRST_FRAMES, _FRAMES_OF_A_LOSS = 64, 144

#: Notes when a segmenter's process has made its first label map: a stream that goes on has a new one.
LABELLED = Trap("mlbs_actors.actors.stream.segmenter_actor:SegmenterActor.step", "note", when="after")


def frames_for_losses(losses: int) -> int:
    """Length of a stream that has still something to do after so many losses."""
    return _FIRST_FRAMES + _FRAMES_OF_A_LOSS * losses


Loss = Callable[[ObservedRun, Plant], None]


def bring_about_losses(
    place: Place,
    verdicts: Verdicts,
    losses: Sequence[tuple[str, Loss]],
    lines: Sequence[str],
    traps: Sequence[Trap] = (),
) -> None:
    """Run streams, and let them lose processes.

    Parameters
    ----------
    place : Place
    verdicts : Verdicts
    losses : sequence of str and callable
        Names of faults, and what brings them about in a run; returns when it has happened. The first is
        brought about when all streams have committed something, each other one when they have committed more
        than there was at the last: a stream that gets no further may be lost a few times only.
    lines : sequence of str
        Streams, of :func:`frames_for_losses`.
    traps : sequence of Trap
        To lay in the run.
    """
    place.prepare(lines)
    plant = Plant(place.folder / "plant", [LABELLED, *traps])
    with ObservedRun(lines, place.folder, plant=plant) as run:
        reached = {line.split()[0]: 0 for line in lines}
        for name, bring_about in losses:
            with verdicts.of(name) as verdict:
                _await_progress(run, reached)
                verdict.back = _lose(run, plant, bring_about, reached)
                expect_prefix(place, run, *lines)
        with verdicts.of(losses[-1][0]):  # of the others, what comes next has shown that all is well
            expect_end(run, 0)
            expect_identical(place, run, *lines)


def _await_progress(run: ObservedRun, reached: Mapping[str, int]) -> None:
    """Wait until every stream that goes on has committed more label maps than are told."""

    def got_on() -> bool:
        status = run.status()
        return bool(status) and all(
            status[name]["committed"] > before or status[name]["state"] == "done"
            for name, before in reached.items()
        )

    run.wait(got_on, "a commit")


def _lose(run: ObservedRun, plant: Plant, bring_about: Loss, reached: dict[str, int]) -> Back:
    """Bring a loss about, and wait until all go on; tell how many label maps each stream had by then."""
    returns = {name: stream["returns"] for name, stream in run.status().items()}
    newest = {name: newest_label_map(run.output / name) for name in returns}
    began = time.monotonic()  # not after it: a quick stream may have gone on when that returns
    bring_about(run, plant)
    reached.update({name: newest_label_map(run.output / name) + 1 for name in returns})

    def hit() -> set[str]:
        return {name for name, stream in run.status().items() if stream["returns"] > returns[name]}

    return seconds_back(run, plant, began, newest, hit)


def seconds_back(
    run: ObservedRun, plant: Plant, began: float, newest: Mapping[str, int], hit: Callable[[], Set[str]]
) -> Back:
    """Wait until label maps are made again, and until one is there that was not there before.

    Parameters
    ----------
    run : ObservedRun
    plant : Plant
        Of the run, with :data:`LABELLED`.
    began : float
        Just before something was lost, monotonic, s: what has gone on by the time of this call counts, too.
    newest : mapping of str to int
        Newest label map of each stream at that time.
    hit : callable
        Names of the streams that have gone back, as far as that is known yet.
    """

    def labelled() -> list[float]:
        return [noted for noted in plant.noted(LABELLED) if noted > began]

    run.wait(lambda: bool(labelled()), "a label map after the loss")
    first = labelled()[0] - began

    def got_on() -> bool:
        return any(
            newest_label_map(run.output / name) > newest[name] or run.status()[name]["state"] == "done"
            for name in hit()
        )

    run.wait(got_on, "a new label map after the loss")
    return Back(first, time.monotonic() - began)


def newest_label_map(stream: Path) -> int:
    """Number of the newest label map that is written, though it may not count yet; −1 for none."""
    names = (path.name.lstrip(".").partition(".")[0] for path in (stream / "masks").glob("*"))
    return max((int(name) for name in names), default=-1)
