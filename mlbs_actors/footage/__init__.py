"""What a frame is before anything is learnt from it: a picture of the scene, of another one, or none.

Read in this order: ``pictures`` (frames that show nothing new), ``light`` (exposure and white balance),
``continuity`` (whether the flow finds the scene again, and torn pictures), ``continuation`` (all together).
:mod:`mlbs_actors.coordinator.gate` decides by them what becomes of a frame.

Not in the paper, whose sequences are whole.
"""
