"""Where results go: label maps, tables, the commit log, the overlay video."""
