"""What nodes and commands share: start, parameters, diagnostics, listeners."""
