"""What is safely on disk: files that are replaced as a whole, the commit log, tables, segments, snapshots.

Below :mod:`orchestrator.sinks` and :mod:`orchestrator.run`, which it does not know.
"""

from orchestrator.extra import require_run

require_run()
