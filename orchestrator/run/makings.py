"""What is made of the streams of a run once it has ended (``--make``)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

from mlbs_actors.errors import ConfigError
from orchestrator.run.job import Job
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_state import StreamState, has_ended

__all__ = ["make_of_all"]


def make_of_all(
    kinds: Sequence[str],
    job: Job,
    due: Collection[str],
    states: Sequence[StreamState],
    folder: RunFolder,
    say: Callable[[str], None],
) -> None:
    """Make the kinds of each file that ended now, or of which they are missing; tell what cannot be made.

    A signal ends it, but not the run: see :mod:`orchestrator.early_signals`.
    """
    if not kinds:
        return
    # Imported here, because it imports the engine, which the driver needs for nothing else.
    from orchestrator.make.making import MADE, Request, make
    from orchestrator.make.writing import Manner

    ended = {state.name for state in states if state.committed and has_ended(state)}
    for spec in job.specs:
        if spec.live or spec.name not in ended:
            continue
        for kind in kinds:
            if spec.name not in due and any((folder.stream(spec.name) / MADE).glob(f"{kind}.*")):
                continue
            request = Request(kind, folder.path, Manner.asked(kind), stream=spec.name, replace=True)
            try:
                say(f"Making {kind} of {spec.name}.")
                for path in make([request], say):
                    say(str(path))
            except ConfigError as error:
                say(f"There is no {kind} of {spec.name}. {error}")
            except SystemExit:  # a signal; the run is complete without it
                say(f"To make {kind} of {spec.name}, give the same command with --resume.")
                return
