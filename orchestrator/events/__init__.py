"""What happens in a stream, as events: in a file of its record, and sent to whoever waits for them.

Read :mod:`.zones` (what is asked for), :mod:`.happenings` (the pure state machine), :mod:`.event_file` (the
part of the record), then :mod:`.targets` and :mod:`.delivery` (sending, in the run's own process).
"""
