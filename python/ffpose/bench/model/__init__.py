"""`ffpose bench model`: networks, in torch and where they are deployed."""
