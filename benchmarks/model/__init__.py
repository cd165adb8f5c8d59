"""`python -m benchmarks model`: networks, in torch and where they are deployed."""
