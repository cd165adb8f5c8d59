"""``ffpose bench``: the filter and the networks, timed on this machine.

What the documentation prints, against more rivals, is measured by ``benchmarks/`` in the
repository.
"""
