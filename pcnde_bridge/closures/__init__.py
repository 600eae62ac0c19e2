"""The ``physics`` preset: flow, area and pressure from closures that obey what the data obey."""
