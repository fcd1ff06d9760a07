"""What happens in a stream, as events: in a file of its record, and sent to whoever waits for them.

The way of an event::

    row of the record
      .happenings, .rule_machine    what is certain with it, by .zones and .rules; the state is .event_state
      .event_file, .event_marks     a line of events.jsonl; .stream_events adds pictures and views
    events.jsonl                    the process of the run looks for new lines
      .intake, .outbox              waits for each of .targets that wants it, by .event_filter
      .carrier                      takes it there, by .senders or .mqtt; all carriers are .delivery
    acknowledged

So an event is written down in two places, as they go back differently: the file to the last commit, what was
taken to be sent never. What all events of a stream come to is their :mod:`.census`, which
:mod:`.home_assistant` tells. :mod:`.scene` finds the scene again under a moving camera, by :mod:`.views` of
it; :mod:`.pictures` are those of events, and :mod:`.recent` are the newest ones, for page and report.
"""
