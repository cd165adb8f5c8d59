"""Evaluation: pose errors, their breakdown and significance, calibration, reports, model cards.

`ffpose.evaluation.evaluate` evaluates weights on an image set; `ffpose.evaluation.card` measures
them under several conditions. Importing this package imports nothing else.
"""
