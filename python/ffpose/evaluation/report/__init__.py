"""Output of an evaluation: result files, plots, and an HTML page."""
