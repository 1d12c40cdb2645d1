"""The work behind every command: paths in, paths and results out."""
