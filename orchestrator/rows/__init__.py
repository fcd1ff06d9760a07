"""What a record knows of each frame, and what events, tables and lists of objects are made of.

Read :mod:`.frame_row` first; :mod:`.scene_place`, :mod:`.sighting` and :mod:`.endings` say where the scene is
in a frame, where an object is, and how it ends.
"""
