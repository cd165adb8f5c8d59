"""The figures of the documentation: measured into data files, from which the pages take them.

`documents` measures and writes ``docs/figures/NAME.json``; `blocks` says what a page shows of them;
`marks` puts that between the marks of a page. ``python -m benchmarks pages`` does both.
"""
