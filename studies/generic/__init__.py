"""Weights to start from: a network that has learned from many spacecraft, without a head."""
