"""`ffpose demo`: the whole pipeline on rendered scenes, and its report."""
