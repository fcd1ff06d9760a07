"""Scoring label maps against truth, behind ``scripts/evaluate``.

Read :mod:`.options` and :mod:`.command` (what is asked for, and who does it), :mod:`.datasets` and
:mod:`.sequences` (pictures and truth), :mod:`.labelling` (label maps of a run or of the engine),
:mod:`.scoring` with :mod:`.sequence_scorer` (figures of one sequence), then :mod:`.figures` and
:mod:`.figure_files` (tables and files). The rest are single questions: :mod:`.ablation`, :mod:`.disturbance`,
:mod:`.sizes`, :mod:`.paper_tables`, :mod:`.reliability`.
"""
