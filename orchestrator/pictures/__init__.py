"""What people see of a frame: labels, zones and texts drawn over it, and what is hidden in it.

Read :mod:`.drawing` first. Below :mod:`orchestrator.events` and :mod:`orchestrator.sinks`, which it does not
know.
"""
