"""What people make of a finished run: videos, pictures and clips of what it has found.

Read :mod:`.kinds` and :mod:`.writing` first. Sources are read again, and label maps come from the tables;
:mod:`.footage` pairs them. Above :mod:`orchestrator.export`, which it builds on.
"""
