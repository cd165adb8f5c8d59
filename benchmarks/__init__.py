"""Benchmarks: the measurements behind the speed results in the documentation.

``python -m benchmarks --help``, from the root of the repository. ``pages`` measures the data files
``docs/figures/*.json`` and puts their figures into the pages; the others print one benchmark.
"""
