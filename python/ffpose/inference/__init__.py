"""Poses from images, by weights in torch or by an exported graph without torch.

* `ffpose.load` opens either and returns a `ffpose.inference.estimator.PoseEstimator`.
* `ffpose.inference.source` finds what was named: shipped weights, a file, or a folder that holds
  one.

Importing this module imports nothing else; torch is imported for weights alone.
"""
