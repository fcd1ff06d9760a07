"""A run over many streams: the list, admission, progress, recovery, and the run's files.

Read in this order: ``run`` (from the arguments to the exit status), ``listed_stream``, ``stream_list``,
``cameras_file`` and ``list_watch`` (what the list says), ``stream_settings`` (what is asked of each stream),
``job`` (the streams in the driver's form, and what becomes of changes), ``identity`` and ``resumption`` (what
an earlier run has left), ``driver``, ``driven_stream`` and ``spec_change`` (the loop, a stream in it, and
changes that it follows), ``admission`` and ``load`` (which streams may start, and what they take),
``node_check`` and ``versions`` (which nodes of a cluster can be used), ``stream_state``, ``recovery`` (which
streams restart), ``run_folder`` with ``run_description`` and ``status_file``, ``whole_overlays``.
"""

from orchestrator.extra import require_run

require_run()
