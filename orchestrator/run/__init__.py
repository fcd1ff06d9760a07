"""A run over many streams: the list, admission, progress, recovery, and the run's files.

Read in this order: ``run`` (from the arguments to the exit status), ``stream_list`` and ``list_watch``,
``driver`` (the loop), ``admission`` (which streams may start), ``stream_state``, ``recovery`` (which streams
restart), ``run_folder`` and ``durable_files``.
"""
