"""What people make of a finished run."""
