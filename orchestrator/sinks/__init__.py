"""Where results go: label maps, lists, pictures, the overlay video; by :mod:`orchestrator.storage`."""
