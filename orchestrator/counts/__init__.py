"""What the events of a stream come to, hour by hour, in files that outlive the record itself.

Read :mod:`.tally` first, which counts rows and their events; :mod:`.table` says what an hour is in
``counts.csv``, :mod:`.count_files` writes the files of a stream, and :mod:`.stream_counts` reads them for
pages and metrics.
"""
