"""What is made of the rows of a record, :mod:`mlbs_actors.record.frame_row`, for events and lists of objects.

:mod:`.sighting` and :mod:`.endings` say where an object is, and how it ends.
"""
