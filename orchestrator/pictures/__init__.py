"""What pictures of a run show beside their labels, and what is hidden in them.

:mod:`mlbs_actors.pictures` draws the labels. Below :mod:`orchestrator.events` and :mod:`orchestrator.sinks`,
which it does not know.
"""
