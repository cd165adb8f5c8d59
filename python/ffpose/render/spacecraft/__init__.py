"""Spacecraft: meshes, their materials, and the models that are built in."""
