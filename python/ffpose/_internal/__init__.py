"""What the package itself needs and users do not: files, options, seeds, facts of the machine."""
