"""``ffpose bench``: timings on this machine; the repository's ``benchmarks`` has more rivals."""
