"""Light: where rays meet the scene, what they bring back, and what a sensor makes of it."""
