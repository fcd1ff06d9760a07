"""What a run takes of the disk; see :mod:`orchestrator.disk_use.measured`."""
