"""Many streams: the command line, stream lists, sources, admission, sinks, the record and its reports.

``mlbs_actors`` processes the frames of one stream; this package delivers them and keeps the results.
"""
