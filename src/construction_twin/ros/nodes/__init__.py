"""The nodes: a class each around the library, its table of topics and services, its check."""
