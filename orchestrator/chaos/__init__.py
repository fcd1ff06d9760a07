"""Brings faults about in real runs of the command, and tells which of them it survives."""
