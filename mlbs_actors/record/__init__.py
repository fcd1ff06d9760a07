"""Reading what a run has recorded: :func:`recorded_stream` yields a stream's frames one by one.

=====================  ==============================================================================
``streams_of``         the names of a run's streams
``description_of``     its ``run.json``
``recorded_stream``    the committed frames of a stream, each a ``RecordedFrame`` with its label map
``edits_of``           corrections of its ids by hand, which ``recorded_stream`` applies
=====================  ==============================================================================

The tables are read with packages of the extra ``read``: ``pip install 'mlbs-actors[read]'``. Below these,
:mod:`.commits` says which frames count, :mod:`.record_tables` reads the rows, which are those of
:mod:`.frame_row`.
"""

from mlbs_actors.record.recorded_stream import (
    RecordedFrame,
    description_of,
    edits_of,
    recorded_stream,
    streams_of,
)

__all__ = ["RecordedFrame", "description_of", "edits_of", "recorded_stream", "streams_of"]
