"""Benchmarks: the measurements behind the speed results in the documentation."""
