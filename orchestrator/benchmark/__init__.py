"""How long the engine takes, and what else one could use, measured in one run."""
