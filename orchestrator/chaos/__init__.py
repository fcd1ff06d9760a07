"""Injects faults into real runs of the command, and tells which of them it survives."""
