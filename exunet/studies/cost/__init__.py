"""Cost of accuracy: settings of a scene with their wall times, errors and measures."""
