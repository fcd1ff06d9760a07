"""Minimum of an energy with contrast-sensitive pairs and label costs (§7), by alpha-expansion.

Read in this order: ``energy`` (what is minimised), ``graph_cut`` (how), ``coarse_cut`` (coarse to fine),
``persistency`` (pixels that are decided before any cut), ``expansion`` and ``expansion_state``, ``min_cut``,
``label_removal`` (labels that cost more than they save).
"""
