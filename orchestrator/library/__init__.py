"""Streams on Ray for programs: :func:`start`, which is what the command does, with results as they come.

In reading order: ``starting`` puts a run together; ``run`` is what its program holds; ``delivered_record``
hands over each result when it is committed, ``result_queue`` keeps them until they are taken; ``session``
finds or starts Ray. Only the modules that need Ray import it.
"""

from orchestrator.library.result import StreamResult
from orchestrator.library.starting import start

__all__ = ["StreamResult", "start"]
