"""Commands that a person types, and those that a launch file starts."""
