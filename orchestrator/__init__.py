"""Many streams: the command line, stream lists, sources, admission, sinks, the record and its reports.

What one stream does with its frames is ``mlbs_actors``; this package feeds it and keeps its results.
"""
