"""What happens in a stream, as events: in a file of its record, and sent to whoever waits for them.

Read :mod:`.zones` and :mod:`.rules` (what is asked for), :mod:`.happenings` and :mod:`.rule_machine` (the
pure state machine, whose state is in :mod:`.event_state`), :mod:`.event_file` and :mod:`.stream_events` (the
part of the record). Then, in the run's own process, :mod:`.targets` (who is sent what, by
:mod:`.event_filter`), :mod:`.intake` and :mod:`.outbox` (what waits), :mod:`.delivery` and :mod:`.carrier`
(sending, by :mod:`.senders` and :mod:`.mqtt`), and :mod:`.home_assistant`, which is told what the events come
to: their :mod:`.census`. :mod:`.scene` finds the scene again under a moving camera, by :mod:`.views` of it;
:mod:`.pictures` are those of events, and :mod:`.recent` are the newest ones, for page and report.
"""
