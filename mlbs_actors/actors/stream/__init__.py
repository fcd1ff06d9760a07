"""The processes of one stream, in the order of a frame's way.

``reader`` or ``live_reader``, ``coordinator_actor`` (with ``account`` and ``live_layers``),
``segmenter_actor`` (with ``layers_at_work``), ``layer_actor``, ``sink``. ``protocol`` is what the
orchestrator and these agree on, ``order`` refuses a frame that is not the next, ``saved_states`` is what a
snapshot holds.
"""
