"""Sources of frames: files, folders, cameras, synthetic scenes."""

from orchestrator.extra import require_run

require_run()
