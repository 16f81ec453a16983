"""The process `place`: from its stock to its place with a tool that grips. `process` finds it by its name."""
