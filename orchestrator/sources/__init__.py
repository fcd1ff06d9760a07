"""Sources of frames: files, folders, cameras, synthetic scenes."""
