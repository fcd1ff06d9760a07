"""Scoring label maps against truth: metrics, sequences with truth, contact sheets, the command."""
