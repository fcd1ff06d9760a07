"""Scoring label maps against truth, behind ``scripts/evaluate``.

For programs it has ``open_sequence``, which opens a sequence of a data set.

Read :mod:`.options` and :mod:`.command` (what is asked for, and who does it), :mod:`.datasets` and
:mod:`.sequences` (pictures and truth), :mod:`.labelling` (label maps of a run or of the engine),
:mod:`.scoring` with :mod:`.sequence_scorer` (figures of one sequence), then :mod:`.figures` and
:mod:`.figure_files` (tables and files). The rest are single questions: :mod:`.ablation`, :mod:`.disturbance`,
:mod:`.sizes`, :mod:`.paper_tables` with :mod:`.published_figures`, :mod:`.reliability`.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orchestrator.evaluation.datasets import open_sequence

__all__ = ["open_sequence"]

#: The modules of these names, which are imported when they are asked for: the help needs none.
_HOMES = {
    "open_sequence": "orchestrator.evaluation.datasets",
}

if not TYPE_CHECKING:  # hidden from type checkers, which would accept every name

    def __getattr__(name: str) -> object:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        from orchestrator.extra import require_run

        require_run()
        return getattr(import_module(_HOMES[name]), name)
