"""A run over many streams: the list, which of them run and which wait, what becomes of each, and its files.

Read in this order: ``run`` (from the arguments to the exit status), ``stream_list`` and ``list_watch``,
``driver`` (the loop), ``admission`` (who may start), ``stream_state``, ``recovery`` (who goes back),
``run_folder`` and ``durable_files``.
"""
