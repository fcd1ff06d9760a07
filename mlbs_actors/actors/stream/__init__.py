"""The processes of one stream, in the order in which a frame passes through them.

``reader`` or ``live_reader``, ``coordinator_actor`` (with ``links``, ``account``, ``live_layers`` and
``snapshots``), ``segmenter_actor`` (with ``layers_at_work``), ``layer_actor``, ``sink``.

``messages`` has what they say to each other, ``protocol`` is the interface to the orchestrator, ``order``
refuses a frame that is not the next, ``saved_states`` defines the contents of a snapshot.
"""
