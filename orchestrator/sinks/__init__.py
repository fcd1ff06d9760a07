"""Where results go: label maps, lists, pictures, the overlay video; by :mod:`orchestrator.storage`."""

from orchestrator.extra import require_run

require_run()
