"""From a mesh file to a network that poses the spacecraft, by one command.

`ffpose.learn.plan` chooses everything from the mesh and the measured speed of this machine;
`ffpose.learn.run` renders, trains, calibrates, tests and exports.
"""
