"""`python -m benchmarks filter`: the spectral filter and its rivals, timed in turn."""
